"""The device of docs/how-to/add_a_device.md at a port, beside a profile that names nothing else."""

import shutil

import pytest

from run import cli
from tests.contracts.test_a_new_sensor import Weighed
from tests.data.force_sensor.device import EmulatedForceSensor
from tests.wire.conftest import Serve

PROFILE = """
experiment = "rest:Rest"

[devices.scale]
driver = "my_lab.device:ForceSensor"
port = "PORT"

[behavior]
stream = "scale.force"

[limits]
travel_m = 0.01
speed_m_s = 0.01
force_stream = "none"
position_stream = "none"
"""

REST = """
from behaviors.machine import Behavior, StatePlan, on
from drivers.core.settings import Settings, StreamName

COLUMNS = ("force_n",)


class RestSettings(Settings):
    stream: StreamName


class Rest(Behavior):
    table = (on("deadline", "RESTING", "DONE"),)

    def __init__(self, settings: RestSettings, factors: Settings, detectors: frozenset[str]) -> None:
        super().__init__({"RESTING": StatePlan(0.5, measures=frozenset({settings.stream}))})

    def enter_DONE(self) -> None:
        self.conclude("weighed")


def measure(evidence, settings, outcome):
    return outcome, {"force_n": float(evidence.series(settings.stream)[1].mean())}
"""


@pytest.fixture
def port(serve: Serve) -> str:
    return serve(EmulatedForceSensor(None, Weighed()))


def test_a_device_made_by_the_page_is_opened_and_read_at_its_port(port, tmp_path, monkeypatch, capsys):
    shutil.copytree("tests/data/force_sensor", tmp_path / "my_lab")
    (tmp_path / "rest.py").write_text(REST)
    (tmp_path / "scale.toml").write_text(PROFILE.replace("PORT", port))
    monkeypatch.chdir(tmp_path)

    def check(*arguments):
        with pytest.raises(SystemExit):  # by which code depends on whether the far end's thread was held up
            cli.main(["check", "scale.toml", *arguments], prog_name="run.py")
        return capsys.readouterr()

    assert "not verified without --connect" in check().out
    read = check("--connect")
    assert "scale: FS1, serial 0042" in read.out
    assert " in 1 s, force 1.5 +- 0 N" in read.out
    assert read.err == ""
    assert "did you mean scale.force?" in check("--connect", "--set", "behavior.stream=scale.fource").err
