"""Benches that are not what their profile says: each run ends before motion, by the line that names what is wrong.

The emulated devices are those of one profile, the run has another. A reversed axis and an unplugged load cell are in
tests/scenarios/test_stopping.py; boards that reset are waited for, hands that sleep are woken, or named where they do
not come: tests/unit/drivers/serial_lines, sensor_board and barrett_hand.
"""

import json
from contextlib import closing
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


def bench(profile: str, settings: dict[str, str], realtime: bool = False) -> closing[EmulatorProcess]:
    return closing(start_emulator(load_profile(profile, settings), realtime))


def options(settings: dict[str, str]) -> list[str]:
    return [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]


@pytest.fixture
def ended(verb, tmp_path):
    """Runs a profile on a bench; how the run ended: exit code and last line."""

    def run(emulator, profile, *options):
        ends = tmp_path / "ends.json"
        ends.write_text(json.dumps(emulator.endpoints))
        code, _, err = verb("run", profile, "--endpoints", ends, "--out", tmp_path, *options)
        return code, err.strip().splitlines()[-1]

    return run


@pytest.mark.parametrize(
    ("profile", "there", "stated", "named"),
    [
        ("first_contact", {"devices.stage.microstep_m": "0.047625e-6"}, {}, ("stage", "microstep_m", "travel_m")),
        ("transient_arm", TOOL, TOOL | {"devices.arm.tcp_offset": "[0.0, 0.0, 0.2, 0, 0, 0]"}, ("arm", "tcp", "0.2")),
    ],
    ids=["other pitch", "other tool"],
)  # fmt: skip
def test_a_device_that_differs_from_the_profile_is_refused_before_anything_moves(
    ended, profile, there, stated, named
):
    with bench(f"emulated/{profile}", there) as emulator:
        before_m = emulator.scene()["probe_m"]
        code, line = ended(emulator, f"emulated/{profile}", *options(stated))
        assert code == 3
        check_refusal(line, *named)
        assert emulator.scene()["probe_m"] == before_m


def test_the_port_of_another_device_is_named(ended):
    with (
        bench("emulated/first_contact", {}, realtime=True) as emulator,
        bench("emulated/static", {}) as other,
    ):
        port = other.endpoints["devices"]["board"]["port"]
        code, line = ended(emulator, "emulated/first_contact", "--set", f'devices.stage.port="{port}"')
        assert code == 3
        check_refusal(line, "stage", port)
        assert emulator.scene()["probe_m"] == 0.0


def test_a_port_that_a_second_program_holds_is_named(ended):
    with bench("emulated/first_contact", {}) as emulator:
        port = emulator.endpoints["devices"]["stage"]["port"]
        with serial.Serial(port, exclusive=True):
            code, line = ended(emulator, "emulated/first_contact")
        assert code == 3
        check_refusal(line, "stage", port, "another program")


def test_a_noisy_cable_ends_before_motion_or_is_counted(verb, tmp_path: Path):
    noise = '[{ device = "stage", kind = "corrupt", at_s = 0.0 }]'
    code, _, err = verb("run", "emulated/first_contact", "--out", tmp_path, "--set", f"faults={noise}")
    assert code == 3
    check_refusal(err.strip().splitlines()[-1], "stage", "cable")


def test_a_load_cell_of_the_wrong_sign_ends_at_the_first_touch_by_its_name(verb, tmp_path: Path):
    profile = tmp_path / "mine.toml"
    profile.write_text(
        """
        extends = "emulated/first_contact"
        detectors.contact.input = "uno.force"
        behavior.load_cell_stream = "uno.force"
        limits.force_stream = "uno.force"
        [devices.uno]
        driver = "serial_lines"
        port = "emulated"
        rate_hz = 1000.0
        streams.force = { columns = [1], unit = "N", scale = 2.4e-5, shows = ["load_cell"] }
        """
    )
    with bench(str(profile), {}) as emulator:
        ends = tmp_path / "ends.json"
        ends.write_text(json.dumps(emulator.endpoints))
        turned = ("--only", 1, "--set", "devices.uno.streams.force.scale=-2.4e-5")
        code, out, err = verb("run", profile, "--endpoints", ends, "--out", tmp_path, *turned)
    assert code == 1
    check_refusal(err.strip().splitlines()[-1], "wrong sign", "reads a push as negative", "scale")
    assert "trial 1 touch 1: wrong sign" in out
