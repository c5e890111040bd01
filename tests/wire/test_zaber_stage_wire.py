"""The real driver, with real pyserial, against the emulated stage on a pty."""

from typing import Any

import pytest

from drivers.core.errors import SilentError
from drivers.core.messages import Failed, Refused, Stop
from drivers.zaber_stage.driver import ZaberStage
from drivers.zaber_stage.mounting import ZaberStageSettings
from tests.unit.drivers.zaber_stage.stage_bench import StageBench, Wire


def test_after_a_failed_opening_the_port_is_free_again(serve: Any) -> None:
    wire = Wire()
    wire.silent = True
    port = serve(wire)
    stage = ZaberStage("stage", ZaberStageSettings(port=port, reply_timeout_s=0.2), serve.clock)
    with pytest.raises(SilentError):
        stage.open()
    with serve.lock(port):
        wire.silent = False
    assert stage.open().mover
    stage.close()
    stage.close()


def test_a_pulled_plug_is_a_failure_and_a_stop_after_it_is_refused_for_it(serve: Any) -> None:
    wire = Wire(homed=True)
    port = serve(wire)
    # Patient, for a machine with other work: a reply that is late by half a second is no loss here.
    settings = ZaberStageSettings(port=port, retry_s=0.5, reply_timeout_s=5.0)
    b = StageBench(ZaberStage("stage", settings, serve.clock), serve.clock, wire)
    serve.unplug(port)
    reason = b.expect(Failed).reason
    assert "taken away" in reason
    b.stage.apply(Stop("stage"))
    assert b.expect(Refused).reason == reason
    b.stage.close()
