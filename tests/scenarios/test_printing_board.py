"""The resonant finger with a board that prints lines in place of the sensor board, in virtual time."""

import csv
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from config.profile import load_profile
from drivers.core.clock import VirtualClock
from drivers.core.messages import Lost
from simulator.devices.faults import FaultSchedule
from simulator.devices.serial_lines import WRAPS_S
from simulator.mocks.ni_daq import MockNiDaq
from simulator.mocks.serial_lines import MockSerialLines
from tests.contracts.crank import Crank
from tests.refusals import check_refusal

PROFILE = Path("tests/data/serial_lines.toml")

ANALOG = Path("tests/data/ni_daq.toml")

PAGE = Path("docs/reference/sensors.md")

STATIC = """
extends = ["mock/static", "BENCH"]

[behavior]
accelerometer_stream = "uno.accelerometer"
"""

ALONE = """
extends = "BENCH"

[devices.uno.streams.force]
columns = [1]
unit = "m/s2"
shows = ["accelerometer"]

[behavior]
load_cell_stream = "none"

[limits]
force_stream = "none"
force_n = "none"
"""


@pytest.fixture
def rows(verb: Any, tmp_path: Path) -> Any:
    def run(profile: str | Path, *sets: str) -> list[dict[str, str]]:
        options = [part for each in sets for part in ("--set", each)]
        code, _, err = verb("run", profile, *options, "--no-report", "--out", tmp_path / "runs")
        assert code == 0, err
        (folder,) = (tmp_path / "runs").iterdir()
        return list(csv.DictReader((folder / "trials.csv").read_text().splitlines()))

    return run


@pytest.mark.parametrize("profile", [PROFILE, ANALOG])
def test_the_page_shows_the_profile_that_is_tested(profile: Path) -> None:
    assert f"```toml\n{profile.read_text()}```" in PAGE.read_text()


@pytest.mark.parametrize("name", ["udp_force", "bota"])
def test_a_force_sensor_is_the_load_cell_as_the_page_says(rows: Any, name: str) -> None:
    profile = Path(f"tests/data/{name}.toml")
    assert f"```toml\n{profile.read_text()}```" in PAGE.read_text()
    trials = '[{ location = "f", speed_m_s = 0.0045 }]'
    sets = ("behavior.settle_s=2.0", "trials.repeats=1", f"trials.list={trials}", "behavior.detector=ours")
    (row,) = rows(profile, *sets)
    assert row["outcome"] == "contact"
    assert 0.0 < float(row["force_peak_n"]) < 1.0
    assert float(row["onset_s"]) == pytest.approx(float(row["truth_contact_s"]), abs=0.05)


def test_the_sketch_prints_the_columns_of_the_profile_at_its_rate() -> None:
    (sketch,) = re.findall(r"```cpp\n(.*?)```", PAGE.read_text(), re.DOTALL)
    settings: Any = load_profile(PROFILE, {}).devices["uno"].settings
    assert sketch.count("Serial.print") == settings.fields + 2  # a separator after each but the last
    assert f"Serial.begin({settings.baud});" in sketch
    assert f"PERIOD_US = {1e6 / settings.rate_hz:.0f};" in sketch
    assert len(sketch.splitlines()) <= 22


@pytest.mark.parametrize("profile", [PROFILE, ANALOG], ids=["lines", "analog inputs"])
def test_a_contact_stops_the_stage(rows: Any, profile: Path) -> None:
    trials = '[{ location = "f", speed_m_s = 0.0045 }]'
    (row,) = rows(profile, "behavior.settle_s=2.0", "trials.repeats=1", f"trials.list={trials}")
    assert row["outcome"] == "contact"
    assert 0.0 < float(row["delay_s"]) < 0.1


@pytest.mark.parametrize(
    ("mock", "profile", "kept", "dropped"),
    [
        (MockSerialLines, PROFILE, "uno.force", "uno.accelerometer"),
        (MockNiDaq, ANALOG, "daq.force", "daq.accelerometer"),
    ],
)
def test_no_sample_of_a_stream_is_lost_where_another_is_no_longer_listened_to(
    mock: Any, profile: Path, kept: str, dropped: str
) -> None:
    """At every place in a block of ten samples."""
    loaded, clock = load_profile(profile, {}), VirtualClock()
    name = kept.partition(".")[0]
    plant = loaded.plant.made(loaded.plant.settings)
    crank = Crank(mock(name, loaded.devices[name].settings, clock, plant, FaultSchedule(())), clock)
    for _ in range(12):
        crank.listen(kept, dropped)
        crank.turn(0.05)
        crank.listen(kept)
        crank.turn(0.053)
    assert not crank.of(Lost)
    blocks = crank.blocks_of(kept)
    assert all(after.seq == before.seq + len(before) for before, after in pairwise(blocks))


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
def test_what_the_twin_prints_is_read_through_a_wrap_of_its_clock(given: dict[str, Any]) -> None:
    loaded, clock = load_profile(PROFILE, {}), VirtualClock()
    settings = loaded.devices["uno"].settings.model_copy(update=given)
    plant = loaded.plant.made(loaded.plant.settings)
    crank = Crank(MockSerialLines("uno", settings, clock, plant, FaultSchedule(())), clock)
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


def test_static_contacts_are_told_apart(rows: Any, tmp_path: Path) -> None:
    profile = tmp_path / "static.toml"
    bench = PROFILE.read_text().replace('extends = "mock/transient"', 'extends = "mock/bench_resonance"')
    bench = re.sub(r"\[detectors.*?(?=\[behavior)", "", bench, flags=re.DOTALL)
    (tmp_path / "bench.toml").write_text(bench)
    profile.write_text(STATIC.replace("BENCH", str(tmp_path / "bench.toml")))
    none, light, full = rows(profile, "behavior.settle_s=2.0")
    # as the sensor board measures them: 28, 30 and 50 Hz (Backus and Dollar, IV.A)
    assert float(none["frequency_hz"]) == pytest.approx(28.0, abs=0.3)
    assert float(full["frequency_hz"]) == pytest.approx(50.0, abs=0.5)
    assert float(none["amplitude_m"]) > float(light["amplitude_m"]) > 5.0 * float(full["amplitude_m"])
    assert (none["frequency_sd_hz"], none["outcome"]) == ("", "recorded"), "nothing counts periods"


def test_an_accelerometer_alone_stops_the_stage_and_measures_no_force(rows: Any, tmp_path: Path) -> None:
    profile = tmp_path / "alone.toml"
    profile.write_text(ALONE.replace("BENCH", str(PROFILE.resolve())))
    (row,) = rows(
        profile, "behavior.settle_s=2.0", "trials.repeats=1", "trials.list=[{ speed_m_s = 0.0045 }]"
    )
    assert row["outcome"] == "contact"
    assert (row["force_n"], row["force_peak_n"], row["delay_s"]) == ("", "", "")


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        ('devices.uno.streams.force.shows=["load"]', ("load", "load_cell", "accelerometer")),
        ("devices.uno.streams.force.shows=[]", ("column 2", "streams.force.shows", "load_cell")),
        ('devices.uno.streams.force.unit="g"', ("column 2", "g", 'unit = "N"')),
    ],
)
def test_a_column_that_shows_nothing_of_the_bench_is_one_line(
    verb: Any, setting: str, named: tuple[str, ...]
) -> None:
    code, _, err = verb("check", PROFILE, "--set", setting)
    assert code == 3
    check_refusal(err, *named)
