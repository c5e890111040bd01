"""A board that prints lines: all at once is what it prints one by one."""

from config.profile import load_profile
from drivers.serial_lines.settings import SerialLinesSettings
from simulator.devices.serial_lines import BANNER, EmulatedSerialLines

FORCE = {"columns": (2,), "unit": "N", "scale": 1e-5, "offset": 8388.0, "shows": ("load_cell",)}
SETTINGS = SerialLinesSettings(
    port="mock", rate_hz=500.0, time_column=0, counter_column=1, counter_modulus=256, streams={"force": FORCE}
)


def board():
    plant = load_profile("mock/transient").plant
    bench = plant.made(plant.settings)
    bench.begin(0.0, 1, 1, {"location": "f"}, plant.settings.model_dump(mode="json"))
    return EmulatedSerialLines(SETTINGS, bench)


def test_lines_that_are_asked_for_at_once_are_those_of_their_times():
    at_once, one_by_one = board(), board()
    assert at_once.printed(0.0)[0] == (0.0, BANNER)
    one_by_one.step(0.0)
    singly = []
    while (due_s := one_by_one.due_s) <= 0.3:
        singly.append((due_s, one_by_one.step(due_s)))
    assert len(singly) == 149
    assert at_once.printed(0.3) == singly
    assert at_once.printed(0.3) == []


def test_what_waits_too_long_at_its_port_is_gone():
    slow, prompt = board(), board()
    for each in (slow, prompt):
        each.step(0.0)
    kept = [line for at_s, line in prompt.printed(0.3) if at_s > 0.25]
    assert slow.step(0.3) == b"".join(kept)
