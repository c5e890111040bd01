"""Runs that are watched: by the page, and by a viewer."""

import asyncio
import gc
import json
import socket
import struct
import warnings
from contextlib import closing
from datetime import UTC, datetime
from http.client import HTTPConnection
from itertools import count
from pathlib import Path
from threading import Thread
from time import sleep

import numpy as np
import pytest
from foxglove import layouts as sdk
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from controller.live_view import LiveView
from controller.recording import layouts
from controller.recording.schemas import sample_schema
from controller.recording.stream_writer import StreamWriter
from controller.reports import figures
from controller.watching import feed
from controller.watching.feed import CLIENTS, SOCKET, Watched, at, curve
from controller.watching.foxglove import FoxgloveStream
from controller.watching.page import Door, alive, serve
from drivers.core.messages import SampleBlock, StreamInfo
from tests.stub_run import StubRun


@pytest.fixture
def run(tmp_path):
    run = StubRun(tmp_path / ("long" * 40))
    yield run
    run.end()


@pytest.fixture
def door(run, monkeypatch):
    monkeypatch.setattr("controller.watching.page.ABSENT_S", 1.5)  # nobody loads it anew
    door = Door.open()
    thread = Thread(target=serve, args=(lambda: run.folder, door), daemon=True)
    thread.start()
    yield door
    run.end()
    thread.join(20.0)
    assert not thread.is_alive(), "the page ends with its run"


def asked(door, path, **headers):
    host, port = door.host.split(":")
    with closing(HTTPConnection(host, int(port), timeout=20.0)) as connection:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        answer.read()
        return answer.status


def test_the_page_is_given_to_those_who_have_the_link(door):
    path = f"/?token={door.token}"
    assert asked(door, path) == 200
    assert asked(door, "/") == 403
    assert asked(door, "/?token=guess") == 403
    assert asked(door, path, Host="evil.example") == 403, "another name for this machine"
    assert asked(door, path, Origin="http://evil.example") == 403


def test_commands_are_taken_from_the_page_alone(run, door):
    address = f"ws://{door.host}/wire?token="
    own = f"http://{door.host}"

    async def tried(token, origin):
        headers = {} if origin is None else {"Origin": origin}
        try:
            wire = await websocket_connect(HTTPRequest(address + token, headers=headers))
        except HTTPClientError as error:
            return error.code
        message = json.loads(await wire.read_message())
        await wire.write_message('{"do": "pause"}')
        while not json.loads(await wire.read_message())["paused"]:
            pass
        wire.close()
        while await wire.read_message() is not None:
            pass
        return message["trial"]

    for token, origin in (("", own), (door.token, None), (door.token, "http://evil.example")):
        assert asyncio.run(tried(token, origin)) == 403
    assert run.received() == []
    assert asyncio.run(tried(door.token, own)) == 3
    assert run.received() == ["pause"]


def watcher(run):
    peer = socket.socket(socket.AF_UNIX)
    peer.settimeout(20.0)
    with at(run.folder / SOCKET) as name:
        peer.connect(name)
    return peer


def test_a_late_client_gets_the_last_minute(run):
    while run.t_s < 2.0:
        sleep(0.01)
    with watcher(run) as peer, peer.makefile() as lines:
        first = json.loads(lines.readline())
    cells = {"location": "f", "speed, mm/s": "3.785", "delay, s": "0.212", "force, N": "0.04"}
    assert first["rows"] == [[2, "contact", cells, True]]
    signal = first["signals"]["board.load_cell"]
    assert signal["t"][0] <= 1.02
    assert signal["t"][-1] >= 1.9
    assert first["signals"]["detector.contact"]["threshold"] == 28.2
    assert first["diagram"]["states"][0] == "HOMING"


def test_a_client_that_does_not_read_gets_nothing_more_and_holds_nothing_up(run):
    with watcher(run) as deaf, watcher(run) as peer, peer.makefile() as lines:
        for _ in range(100):
            deaf.sendall(b"\n" * 2000)
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        for _ in range(5):
            assert json.loads(lines.readline())["trial"] == 3
        peer.sendall(b'no json\n{"do": "answer"}\n{"do": 3}\n{"do": "pause"}\n')
        while not json.loads(lines.readline()).get("paused"):
            pass
    assert run.received() == ["pause"]


def test_a_gap_is_published_as_a_gap():
    times_s = np.concatenate([np.arange(0.0, 1.0, 0.001), np.arange(2.0, 3.0, 0.001)])
    found = curve("board.load_cell", times_s, np.sin(times_s)[:, None], "N", 100)
    place = found["y"].index(None)
    assert found["y"].count(None) == 1
    assert found["t"][place - 1] == 0.999
    assert found["t"][place + 1] == 2.0
    assert found["gap_s"] < 1.0


@pytest.mark.parametrize(
    "line",
    [
        b'{"do": "answer", "number": 1e999, "done": 1}',
        b'{"do": "answer", "number": NaN, "done": 1}',
        b"[" * 3000,
        b'{"do":' * 600,
        b"9" * 4000,
        b'{"do": ["stop"]}',
        b'{"do": {"stop": 1}}',
        b'{"do": "jump"}',
        b"\xff\xfe",
        b"null",
        b"",
    ],
)
def test_no_line_keeps_a_stop_from_being_heard_and_its_sender_gets_the_reason(run, line):
    with watcher(run) as peer, peer.makefile() as lines:
        peer.sendall(line + b"\n")
        while "refused" not in (answer := json.loads(lines.readline())):
            pass
        assert "\n" not in answer["refused"]
        peer.sendall(b'{"do": "stop"}\n')
        while not json.loads(lines.readline())["stopped"]:
            pass
    assert run.received() == ["abort"]


def test_a_detector_that_cannot_be_shown_ends_neither_the_run_nor_the_watching(run, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(LiveView, "panels", lambda self: 1 / 0)
        with watcher(run) as peer:
            assert peer.recv(1) == b""
    with watcher(run) as peer:
        assert peer.recv(1) == b"{"
    assert run.received() == []


def test_a_client_that_only_looks_whether_a_run_is_there_gets_nothing(run, monkeypatch):
    published = []
    monkeypatch.setattr(Watched, "news", lambda self, client: published.append(client) or b"{}\n")
    monkeypatch.setattr(feed, "PUBLISH_S", 60.0)  # it is not time to publish
    assert all(alive(run.folder) for _ in range(3))
    with watcher(run) as peer:
        peer.sendall(b'{"do": "pause"}\n')
        while not run.received():
            sleep(0.01)
    assert published == []


def test_the_end_leaves_no_socket_open_whoever_is_there(run, monkeypatch):
    monkeypatch.setattr(Watched, "news", lambda self, client: b"0" * 10_000_000 + b"\n")
    with warnings.catch_warnings(record=True) as left_open:
        warnings.simplefilter("always", ResourceWarning)
        peers = [watcher(run) for _ in range(CLIENTS - 1)]  # none of them reads
        assert all(peer.recv(1) for peer in peers)
        coming = Thread(target=lambda: all(alive(run.folder) for _ in count()))
        coming.start()
        run.end()
        coming.join(20.0)
        gc.collect()
    for peer in peers:
        peer.close()
    assert [str(one.message) for one in left_open if SOCKET in str(one.message)] == []


def test_no_more_watch_than_there_is_room_for(run):
    inside = [watcher(run) for _ in range(CLIENTS)]
    assert all(peer.recv(1) for peer in inside)
    with watcher(run) as outside:
        assert outside.recv(1) == b""
    for peer in inside:
        peer.close()


def test_a_run_that_has_ended_is_not_alive(run):
    assert alive(run.folder)
    run.end()
    assert not alive(run.folder)
    assert not (run.folder / SOCKET).exists()


INFO = StreamInfo("board.load_cell", ("force",), "N")


@pytest.fixture
def stream():
    stream = FoxgloveStream(port=0)
    yield stream
    stream.close()


def test_a_viewer_receives_what_is_recorded_and_can_call_nothing(stream, tmp_path):
    began, path = datetime(2026, 1, 1, tzinfo=UTC), tmp_path / "recording.mcap"
    writer = StreamWriter(path, began, {INFO.name: INFO}, stream)
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


def test_a_layout_is_made_of_what_the_sdk_knows_of_its_panels_in_the_reports_colours():
    topics = {"/detector/contact": ["statistic", "threshold"], "/board/frequency": ["frequency_hz"]}
    panels = layouts.foxglove(topics)["configById"]
    states = sdk.StateTransitionsConfig(paths=[sdk.StateTransitionsSeries(value="")])
    plot, log = sdk.PlotConfig(paths=[sdk.PlotSeries(value="")]), sdk.LogConfig()
    # the last is as Foxglove calls its log panel
    known = {"Plot": known_of(plot), "StateTransitions": known_of(states), "RosOut": known_of(log)}
    for name, config in panels.items():
        keys, of_paths = known[name.partition("!")[0]]
        assert config.keys() - {"foxglovePanelTitle"} <= keys, name
        assert all(path.keys() <= of_paths for path in config.get("paths", ())), name
    assert layouts.COLOURS == (figures.OURS, figures.FALSE, figures.PAPER, figures.RIVAL)
    light = (Path(figures.__file__).with_name("templates") / "style.css").read_text("utf-8")
    for name in ("OURS", "PAPER", "TRUTH", "RIVAL", "FAINT"):
        assert getattr(figures, name) in light


def known_of(config):
    """Keys of a panel's configuration and of its paths."""
    shown = config._to_dict()
    return shown.keys(), {key for path in shown.get("paths", ()) for key in path._to_dict()}
