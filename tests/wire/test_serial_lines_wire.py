"""A board that prints lines, over a pty: real pyserial, and the finger's trial on it alone."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from config.profile import load_profile
from drivers.core.messages import Lost
from drivers.serial_lines.driver import SerialLines
from simulator.devices.faults import Fault, FaultSchedule
from simulator.devices.serial_lines import WRAPS_S, EmulatedSerialLines
from simulator.wiring.far_ends import Line
from tests.contracts.crank import Crank
from tests.wire.conftest import Serve, Verb

PROFILE = Path("tests/data/serial_lines.toml")

FORCE = "uno.force"


def opened(serve: Serve, *faults: Fault, **given: Any) -> Crank:
    profile: Any = load_profile(PROFILE, {})
    settings = profile.devices["uno"].settings.model_copy(update=given)
    twin = EmulatedSerialLines(settings, profile.plant.made(profile.plant.settings))
    port = serve.wire(Line(twin), FaultSchedule(faults))
    return Crank(SerialLines("uno", settings.model_copy(update={"port": port}), serve.clock), serve.clock)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {
            "checksum": "xor",
            "separator": ";",
            "counter_column": 3,
            "counter_modulus": 256,
            "time_unit_s": 1e-3,
        },
        {"rate_hz": None, "time_column": None},
    ],
)
def test_what_the_twin_prints_is_read_through_a_wrap_of_its_clock(
    serve: Serve, given: dict[str, Any]
) -> None:
    crank = opened(serve, **given)
    crank.listen(*crank.info.streams)
    crank.turn(WRAPS_S + 0.5)
    crank.device.close()
    hz = given.get("rate_hz", 1000.0) or 100.0
    # lines without a time are dated when the machine reads them
    typical = np.median if given.get("rate_hz", 1000.0) else np.mean
    for stream in crank.info.streams:
        times_s = crank.times(stream)
        assert len(times_s) == pytest.approx((WRAPS_S + 0.5) * hz, rel=0.02)
        assert (np.diff(times_s) > 0.0).all()
        assert typical(np.diff(times_s)) == pytest.approx(1.0 / hz, rel=0.05)
    assert not crank.of(Lost)
    assert crank.device.account()["malformed"] == 0
    assert crank.info.details["columns"] == (4 if "counter_column" in given else 3)


def test_the_finger_is_touched_with_one_such_board_alone(verb: Verb, tmp_path: Path) -> None:
    sets = [
        "devices.stage.port=emulated",
        "devices.uno.port=emulated",
        "behavior.settle_s=2.0",
        "detectors.contact.baseline_s=4.0",
        "trials.repeats=1",
        'trials.list=[{ location = "f", speed_m_s = 0.0045 }]',
        # the machine may be busy: what is read late here is no sensor's silence
        "limits.stale_s=5.0",
        "devices.uno.silence_timeout_s=5.0",
    ]
    options = [part for each in sets for part in ("--set", each)]
    assert verb("run", PROFILE, *options, "--out", tmp_path)[0] == 0
    (run,) = tmp_path.iterdir()
    (row,) = csv.DictReader((run / "trials.csv").read_text().splitlines())
    assert row["outcome"] == "contact"
    assert 0.0 < float(row["delay_s"]) < 0.1
    assert float(row["baseline_hz"]) == pytest.approx(28.0, abs=0.5)
    page = (run / "report.html").read_text()
    assert "uno.force" in page
