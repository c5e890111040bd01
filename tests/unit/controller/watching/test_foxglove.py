"""What a viewer in Foxglove receives: the recording's own bytes, and nothing that it could call."""

import asyncio
import json
import struct
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from foxglove import layouts as sdk
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

from controller.recording import layouts
from controller.recording.schemas import sample_schema
from controller.recording.stream_writer import StreamWriter
from controller.reports import figures
from controller.watching.foxglove import FoxgloveStream
from drivers.core.messages import SampleBlock, StreamInfo

INFO = StreamInfo("board.load_cell", ("force",), "N")


@pytest.fixture
def stream():
    stream = FoxgloveStream(port=0)
    yield stream
    stream.close()


def test_a_viewer_receives_what_is_recorded_and_can_call_nothing(stream, tmp_path):
    writer = StreamWriter(
        tmp_path / "recording.mcap", datetime(2026, 1, 1, tzinfo=UTC), {INFO.name: INFO}, stream
    )
    writer.begin_trial(1, {}, 0.0)

    def record(seq):
        values = np.array([[0.25], [0.5]])
        writer.block(SampleBlock(INFO.name, seq, seq / 1000.0, values, rate_hz=1000.0, unit="N"))
        writer.state(seq / 1000.0, "HOMING", "APPROACH")
        writer.commit(sync=False)

    record(0)

    async def received():
        request = HTTPRequest(stream.address)
        viewer = await websocket_connect(request, subprotocols=["foxglove.sdk.v1"])
        operations, channels = {}, {}
        while "/board/load_cell" not in channels:
            message = json.loads(await viewer.read_message())
            operations[message["op"]] = message
            channels |= {each["topic"]: each["id"] for each in message.get("channels", ())}
        subscription = {"id": 7, "channelId": channels["/board/load_cell"]}
        await viewer.write_message(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))
        frame: str | bytes | None = ""
        seq = 0
        while isinstance(frame, str):
            reading = asyncio.ensure_future(viewer.read_message())
            while not reading.done():  # what is recorded before the subscription has arrived is not received
                record(seq := seq + 2)
                await asyncio.wait([reading], timeout=0.05)
            frame = reading.result()
        viewer.close()
        while await viewer.read_message() is not None:
            pass
        return operations, channels, frame

    operations, channels, frame = asyncio.run(received())
    writer.finish()
    assert operations["serverInfo"]["capabilities"] == []
    assert set(channels) == {"/board/load_cell", "/state"}
    code, subscription, _ = struct.unpack_from("<BIQ", frame)
    assert (code, subscription) == (1, 7)
    message = sample_schema(INFO).message.FromString(frame[13:])
    assert message.force_n in (0.25, 0.5)


def test_a_layout_is_made_of_what_the_sdk_knows_of_its_panels():
    topics = {"/detector/contact": ["statistic", "threshold"], "/board/frequency": ["frequency_hz"]}
    panels = layouts.foxglove(topics)["configById"]
    known = {
        "Plot": known_of(sdk.PlotConfig(paths=[sdk.PlotSeries(value="")])),
        "StateTransitions": known_of(
            sdk.StateTransitionsConfig(paths=[sdk.StateTransitionsSeries(value="")])
        ),
        "RosOut": known_of(sdk.LogConfig()),  # as Foxglove calls its log panel
    }
    for name, config in panels.items():
        keys, of_paths = known[name.partition("!")[0]]
        assert config.keys() - {"foxglovePanelTitle"} <= keys, name
        assert all(path.keys() <= of_paths for path in config.get("paths", ())), name


def known_of(config):
    """Keys of a panel's configuration and of its paths."""
    shown = config._to_dict()
    return shown.keys(), {key for path in shown.get("paths", ()) for key in path._to_dict()}


def test_curves_have_the_reports_colours():
    assert layouts.COLOURS == (figures.OURS, figures.FALSE, figures.PAPER, figures.RIVAL)
    light = (Path(figures.__file__).with_name("templates") / "style.css").read_text("utf-8")
    for name in ("OURS", "PAPER", "TRUTH", "RIVAL", "FAINT"):
        assert getattr(figures, name) in light
