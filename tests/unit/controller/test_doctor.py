"""A bench looked at without moving it."""

from typing import Any

import numpy as np
import pytest

from controller.doctor import examine
from controller.rig import Rig, TrialScene
from drivers.core.clock import VirtualClock
from drivers.core.errors import SilentError
from drivers.core.messages import DeviceInfo, Listen, Lost, SampleBlock, StreamInfo

SCENE = TrialScene(0, 0, {})


class Sensor:
    """A device with one stream of what the test gives it, once a turn."""

    def __init__(self, name, clock, value=1.0, rate_hz=100.0, error=None):
        self.name = name
        self.clock = clock
        self.value = value
        self.rate_hz = rate_hz
        self.error = error
        self.commands = []
        self.closed = False
        self.statuses = []
        self.seq = 0

    def open(self):
        if self.error:
            raise self.error
        stream = StreamInfo(f"{self.name}.force", ("fx",), "N", rate_hz=self.rate_hz)
        return DeviceInfo(self.name, "LC-5", serial="17", streams={stream.name: stream})

    def close(self):
        self.closed = True

    def apply(self, command):
        self.commands.append(command)

    def read(self):
        if self.value is None:
            return []
        self.seq += 1
        values = np.array([[self.value]])
        return [
            SampleBlock(f"{self.name}.force", self.seq, self.clock.now(), values, rate_hz=100.0, unit="N")
        ]

    def poll(self):
        statuses, self.statuses = self.statuses, []
        return statuses


def lines(*devices):
    clock = devices[0].clock
    return list(examine(Rig("mock", {device.name: device for device in devices}, clock), SCENE))


@pytest.fixture
def clock():
    return VirtualClock()


def test_every_device_is_named_and_every_sensor_read(clock):
    findings = lines(Sensor("cell", clock, value=0.25))
    assert [finding.line for finding in findings] == [
        "cell: LC-5, serial 17",
        "    cell.force: 100 samples in 1 s, fx 0.25 +- 0 N",
    ]
    assert all(finding.sound for finding in findings)


def test_nothing_is_asked_of_a_device_but_to_listen(clock):
    sensor = Sensor("cell", clock)
    lines(sensor)
    assert sensor.commands == [Listen("cell", frozenset({"cell.force"})), Listen("cell", frozenset())]
    assert sensor.closed


def test_a_silent_sensor_is_found(clock):
    assert [finding.sound for finding in lines(Sensor("cell", clock, value=None))] == [True, False]


def test_an_irregular_stream_may_be_silent(clock):
    assert all(finding.sound for finding in lines(Sensor("cell", clock, value=None, rate_hz=None)))


def test_values_that_are_not_finite_are_found(clock):
    finding = lines(Sensor("cell", clock, value=np.nan))[1]
    assert not finding.sound
    assert "not finite" in finding.line


def test_lost_samples_are_found(clock):
    sensor = Sensor("cell", clock)
    sensor.statuses = [Lost(0.5, "cell", "cell.force", 12)]
    finding = lines(sensor)[-1]
    assert (finding.sound, finding.line) == (False, "    cell.force: 12 samples lost")


def test_a_device_that_does_not_open_hides_no_other(clock):
    deaf = Sensor("stage", clock, error=SilentError("stage", "opening", "no reply", "is it on?"))
    findings = lines(deaf, Sensor("cell", clock))
    assert (findings[0].sound, findings[0].line) == (False, "stage: no reply while opening; is it on?")
    assert findings[1].line.startswith("cell: ")
    assert deaf.closed


def test_all_devices_are_closed_where_the_reader_of_findings_leaves_early(clock):
    sensor = Sensor("cell", clock)
    findings: Any = examine(Rig("mock", {"cell": sensor}, clock), SCENE)
    next(findings)
    findings.close()
    assert sensor.closed
