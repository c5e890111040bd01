"""Benches that are not what their profile says: each run ends before motion, by the line that names what is wrong.

The emulated devices are those of one profile, the run has another. A reversed axis and an unplugged load cell are in
tests/scenarios/test_first_contact.py, its wrong sign in tests/unit/controller/measures; boards that reset and hands
that sleep are waited for and woken: test_sensor_board_wire.py, test_barrett_hand_wire.py.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import serial

from config.assemble import start_emulator
from config.profile import load_profile
from simulator.wiring.emulator_process import EmulatorProcess
from tests.refusals import check_refusal

TOOL = {
    "devices.arm.tcp_offset": "[0.0, 0.0, 0.1, 0.0, 0.0, 0.0]",
    "devices.arm.payload_kg": "1.0",
    "devices.arm.payload_cog_m": "[0.0, 0.0, 0.05]",
}

SHORTER = {"devices.stage.travel_m": "0.02", "devices.stage.travel_max_m": "0.02"}


@contextmanager
def bench(profile: str, settings: dict[str, str], realtime: bool = False) -> Iterator[EmulatorProcess]:
    emulator = start_emulator(load_profile(profile, settings), realtime)
    try:
        yield emulator
    finally:
        emulator.close()


def options(settings: dict[str, str]) -> list[str]:
    return [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]


@pytest.mark.parametrize(
    ("profile", "there", "stated", "named"),
    [
        ("first_contact", {"devices.stage.microstep_m": "0.047625e-6"}, {}, ("stage", "microstep_m", "travel_m")),
        ("first_contact", SHORTER, {}, ("stage", "limit", "travel")),
        ("transient_arm", TOOL, TOOL | {"devices.arm.tcp_offset": "[0.0, 0.0, 0.2, 0, 0, 0]"}, ("arm", "tcp", "0.2")),
        ("transient_arm", TOOL, TOOL | {"devices.arm.payload_kg": "3.0"}, ("arm", "payload", "3", "1")),
    ],
    ids=["other pitch", "a limit that was left over", "other tool", "payload 2 kg off"],
)  # fmt: skip
def test_a_device_that_differs_from_the_profile_is_refused_before_anything_moves(
    verb, tmp_path, profile, there, stated, named
):
    with bench(f"emulated/{profile}", there) as emulator:
        before_m = emulator.scene()["probe_m"]
        ends = tmp_path / "ends.json"
        ends.write_text(json.dumps(emulator.endpoints))
        code, _, err = verb(
            "run", f"emulated/{profile}", "--endpoints", ends, "--out", tmp_path, *options(stated)
        )
        assert code == 3
        check_refusal(err.strip().splitlines()[-1], *named)
        assert emulator.scene()["probe_m"] == before_m


def test_the_port_of_another_device_is_named(verb, tmp_path: Path):
    with (
        bench("emulated/first_contact", {}, realtime=True) as emulator,
        bench("emulated/static", {}) as other,
    ):
        ends = tmp_path / "ends.json"
        ends.write_text(json.dumps(emulator.endpoints))
        port = other.endpoints["devices"]["board"]["port"]
        wrong = {"devices.stage.port": f'"{port}"'}
        code, _, err = verb(
            "run", "emulated/first_contact", "--endpoints", ends, "--out", tmp_path, *options(wrong)
        )
        assert code == 3
        check_refusal(err.strip().splitlines()[-1], "stage", port)
        assert emulator.scene()["probe_m"] == 0.0


def test_a_port_that_a_second_program_holds_is_named(verb, tmp_path: Path):
    with bench("emulated/first_contact", {}) as emulator:
        ends = tmp_path / "ends.json"
        ends.write_text(json.dumps(emulator.endpoints))
        port = emulator.endpoints["devices"]["stage"]["port"]
        with serial.Serial(port, exclusive=True):
            code, _, err = verb("run", "emulated/first_contact", "--endpoints", ends, "--out", tmp_path)
        assert code == 3
        check_refusal(err.strip().splitlines()[-1], "stage", port, "another program")


def test_a_noisy_cable_ends_before_motion_or_is_counted(verb, tmp_path: Path):
    noise = '[{ device = "stage", kind = "corrupt", at_s = 0.0 }]'
    code, _, err = verb("run", "emulated/first_contact", "--out", tmp_path, "--set", f"faults={noise}")
    assert code == 3
    check_refusal(err.strip().splitlines()[-1], "stage", "cable")
