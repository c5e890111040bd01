"""The driver of a force sensor's box on one that sends what a test says, and over loopback."""

import http.server
import threading
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from drivers.core.clock import VirtualClock, WallClock
from drivers.core.errors import PortError, ProtocolError, RefusedError, SilentError
from drivers.core.messages import Failed, Listen, Lost, Refused, Saturated, Sent, Tare
from drivers.udp_force.codec import ForceRecord, decode_request, encode_record
from drivers.udp_force.driver import UdpForce, UdpForceSettings, open_udp
from simulator.devices.udp_force import EmulatedUdpForce
from simulator.mocks.base import MemoryLine
from tests.contracts.crank import Crank
from tests.refusals import refused

STREAMS = ("ft.force", "ft.torque", "ft.normal")

GIVEN: dict[str, Any] = {
    "counts_per_n": 1000.0,
    "counts_per_nm": 500.0,
    "rate_hz": 1000.0,
    "sample_hz": 7000.0,
}

Change = Callable[[int, ForceRecord], ForceRecord | None]


class Box:
    """Sends a thousand records a second; record k has k, 2 k, ... counts."""

    datagram = 36

    def __init__(self, change: Change = lambda k, record: record) -> None:
        self.change = change
        self.requests: list[tuple[str, int]] = []
        self.begun_s: float | None = None
        self.k = 0

    @property
    def due_s(self) -> float:
        return float("inf") if self.begun_s is None else self.begun_s + (self.k + 1) * 1e-3

    def receive(self, data: bytes, t_s: float) -> bytes:
        request = decode_request(data)
        self.requests.append(request)
        if request == ("start", 1):
            return self.record(0)
        if request[0] != "bias":
            self.begun_s, self.k = (t_s if request[0] == "start" else None), 0
        return b""

    def step(self, t_s: float) -> bytes:
        sent = b""
        while self.due_s <= t_s:
            self.k += 1
            sent += self.record(self.k)
        return sent

    def record(self, k: int) -> bytes:
        ft = (2**32 - 3500 + 7 * k) % 2**32
        record = self.change(k, ForceRecord(k, ft, 0, tuple(n * k for n in range(1, 7))))
        return b"" if record is None else encode_record(record)

    def inject(self, kind: str, t_s: float) -> None:
        raise ValueError(kind)


def driver(box: Box, **given: Any) -> UdpForce:
    clock = VirtualClock()
    settings = UdpForceSettings(host="192.168.1.1", **GIVEN | given)
    return UdpForce("ft", settings, clock, MemoryLine(box, clock).connect)


def opened(box: Box, **given: Any) -> Crank:
    return Crank(driver(box, **given))


def test_forces_torques_and_the_normal_are_scaled_numbered_and_dated_through_a_wrap() -> None:
    box = Box()
    crank = opened(box)
    assert {name: stream.unit for name, stream in crank.info.streams.items()} == {
        "ft.force": "N",
        "ft.torque": "N m",
        "ft.normal": "N",
    }
    crank.listen(*STREAMS)
    crank.turn(1.0)
    assert box.requests == [("stop", 0), ("start", 1), ("start", 0)]
    k = np.arange(1, 1001)[:, None]
    np.testing.assert_allclose(crank.values("ft.force"), k * [1.0, 2.0, 3.0] / 1000.0)
    np.testing.assert_allclose(crank.values("ft.torque"), k * [4.0, 5.0, 6.0] / 500.0)
    np.testing.assert_allclose(crank.values("ft.normal"), -k * 3.0 / 1000.0)
    for before, after in pairwise(crank.blocks_of("ft.force")):
        assert after.seq == before.seq + len(before)
        assert after.t0_s == pytest.approx(before.last_s + 1e-3)
    assert not crank.of(Lost)
    crank.listen()
    crank.blocks.clear()
    crank.turn(0.1)
    assert crank.blocks == []
    assert box.requests[-1] == ("stop", 0)
    crank.listen("ft.normal")
    crank.turn(0.1)
    assert not crank.of(Lost), "the box counts anew, and nothing was lost"
    assert {block.stream for block in crank.blocks} == {"ft.normal"}


def test_records_that_are_missing_are_lost_and_late_ones_are_not_taken() -> None:
    def change(k: int, record: ForceRecord) -> ForceRecord | None:
        if k == 301:
            return record._replace(rdt=299)
        return None if 100 <= k < 105 else record

    crank = opened(Box(change))
    crank.listen("ft.normal")
    crank.turn(0.5)
    assert [lost.samples for lost in crank.of(Lost)] == [5, 1]
    account = crank.device.account()
    assert account == {"malformed": 0, "disordered": 1, "drift_ppm": pytest.approx(0.0, abs=1.0)}


def test_records_that_were_on_the_way_when_it_was_started_again_are_not_taken_for_new_ones() -> None:
    class Late(Box):
        sent = 0

        def receive(self, data: bytes, t_s: float) -> bytes:
            late = b"".join(self.record(self.sent + n) for n in (1, 2)) if self.sent and data[3] else b""
            self.sent = self.k
            return late + super().receive(data, t_s)

    crank = opened(Late())
    crank.listen("ft.normal")
    crank.turn(0.3)
    crank.listen()
    crank.device.apply(Listen("ft", frozenset({"ft.normal"})))
    crank.blocks.clear()
    crank.turn(0.5)
    assert not crank.of(Failed)
    assert not crank.of(Lost)
    assert sum(map(len, crank.blocks)) == pytest.approx(500, abs=2)
    crank.listen(*STREAMS)
    crank.turn(0.1)
    assert crank.blocks_of("ft.force")
    assert not crank.of(Failed)
    assert crank.device.account()["disordered"] == 0


def test_saturation_is_reported_once_each_time_and_an_error_of_the_box_ends_it() -> None:
    def change(k: int, record: ForceRecord) -> ForceRecord:
        status = 0x80020000 if k in (50, 51, 90) else 0x90000000 if k == 200 else 0x80010000
        return record._replace(status=status if k else 0)

    crank = opened(Box(change))
    crank.listen("ft.normal")
    crank.turn(0.5)
    assert [one.value for one in crank.of(Saturated)] == pytest.approx([0.15, 0.27])
    (failed,) = crank.of(Failed)
    assert "analog board" in failed.reason


def test_a_saturation_that_lasts_is_reported_again_where_a_stream_is_listened_to_anew() -> None:
    crank = opened(Box(lambda k, record: record._replace(status=0x80020000 if k else 0)))
    crank.listen("ft.normal")
    crank.turn(0.1)
    assert [one.stream for one in crank.take(Saturated)] == ["ft.normal"]
    crank.listen("ft.normal", "ft.torque")
    crank.turn(0.1)
    assert [one.stream for one in crank.take(Saturated)] == ["ft.torque"], "the other one was reported before"
    crank.listen()
    crank.turn(0.1)
    crank.listen("ft.normal")
    crank.turn(0.1)
    assert [one.stream for one in crank.take(Saturated)] == ["ft.normal"], "it is another trial's first"


@pytest.mark.parametrize("word", [0xC0000000, 0x88000000])
def test_an_axia_beyond_its_range_is_saturated(word: int) -> None:
    crank = opened(Box(lambda k, record: record._replace(status=word if k == 50 else 8)), make="axia")
    crank.listen("ft.normal")
    crank.turn(0.2)
    assert [one.value for one in crank.of(Saturated)] == pytest.approx([0.15])
    assert not crank.of(Failed)


def test_tare_asks_the_box() -> None:
    box = Box()
    crank = opened(box)
    crank.device.apply(Tare("ft", "ft.normal"))
    crank.turn(0.01)
    assert box.requests[-1] == ("bias", 255)
    assert [sent.command for sent in crank.of(Sent)] == [Tare("ft", "ft.normal")]


class Tool:
    """A bench whose sensor carries a tool of 3 N."""

    def feel(self, on: bool) -> None:
        pass

    def advance(self, t_s: float) -> None:
        pass

    def wrench(self, times_s: Any, towards: Any) -> Any:
        return np.array([[0.0, 0.0, -3.0, 0.0, 0.0, 0.0]])


@pytest.mark.parametrize("heard", [True, False])
def test_a_tare_is_taken_or_refused_by_what_the_box_reads_then(heard: bool) -> None:
    class Twin(EmulatedUdpForce):
        """As the emulated one; what is lost on its way to it, it cannot take."""

        def receive(self, data: bytes, t_s: float) -> bytes:
            lost = decode_request(data)[0] == "bias" and not heard
            return b"" if lost else super().receive(data, t_s)

    clock, given = VirtualClock(), UdpForceSettings(host="192.168.1.1", **GIVEN)
    box = Twin(given, Tool())  # type: ignore[arg-type]
    crank = Crank(UdpForce("ft", given, clock, MemoryLine(box, clock).connect))
    crank.listen("ft.normal")
    for _ in range(2):  # the second one of a zero that is there already
        crank.turn(0.1)
        crank.blocks.clear()
        crank.device.apply(Tare("ft", "ft.normal"))
        crank.turn(0.2)
        refusals = crank.take(Refused)
        level_n = crank.values("ft.normal")[-1, 0]
        assert level_n == pytest.approx(0.0 if heard else 3.0, abs=0.01)
        assert [type(each.command) for each in refusals] == ([] if heard else [Tare])
        assert all("still reads 3 N" in each.reason for each in refusals)


def test_silence_is_a_failure() -> None:
    crank = opened(Box(lambda k, record: record if k < 50 else None))
    crank.listen("ft.force")
    crank.turn(1.0)
    (failed,) = crank.of(Failed)
    assert "no record in 0.2 s" in failed.reason


def test_a_box_that_is_not_there_or_not_well_is_refused_at_open() -> None:
    with refused(SilentError, "ft", "192.168.1.1", "powered", "RDT"):
        driver(Box(lambda k, record: None)).open()
    with refused(RefusedError, "ft", "82000000", "halted by its configuration"):
        driver(Box(lambda k, record: record._replace(status=0x82000000))).open()

    class Stranger(Box):
        def record(self, k: int) -> bytes:
            return b"220 ready\r\n"

    with refused(ProtocolError, "ft", "datagrams that are no records", "another device"):
        driver(Stranger()).open()


@pytest.fixture
def page() -> Iterator[dict[str, Any]]:
    """A web server; what it answers."""
    answer: dict[str, Any] = {"text": "", "asked": []}

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            answer["asked"].append(self.path)
            self.send_response(200)
            self.end_headers()
            self.wfile.write(answer["text"].encode())

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    server = http.server.HTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    answer["port"] = server.server_port
    yield answer
    server.shutdown()
    server.server_close()


def at(page: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> UdpForce:
    """A driver whose box has this page; a test may not have port 80."""
    monkeypatch.setattr("drivers.udp_force.driver.PAGE", f"http://{{}}:{page['port']}/netftapi2.xml")
    none = dict.fromkeys(GIVEN)
    clock = VirtualClock()
    settings = UdpForceSettings(host="127.0.0.1:40000", reply_timeout_s=5.0, **none)
    return UdpForce("ft", settings, clock, MemoryLine(Box(), clock).connect)


def test_what_the_profile_leaves_open_is_read_from_the_boxs_page(
    page: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    page["text"] = (
        "<netft><scfgfu>N</scfgfu><scfgtu>N-mm</scfgtu><cfgcpf>2000</cfgcpf><cfgcpt>3</cfgcpt>"
        "<comrdtrate>500</comrdtrate><runrate>7000</runrate></netft>"
    )
    streams = at(page, monkeypatch).open().streams
    assert page["asked"] == ["/netftapi2.xml"]
    assert streams["ft.force"].scale == pytest.approx(1.0 / 2000.0)
    assert streams["ft.torque"].scale == pytest.approx(1.0 / 3000.0)
    assert streams["ft.force"].rate_hz == 500.0


def test_a_page_that_says_nothing_is_one_line(page: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    page["text"] = "<html>please log in</html>"
    with refused(ProtocolError, "ft", "scfgfu", "counts_per_n"):
        at(page, monkeypatch).open()


def test_a_box_without_a_page_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with refused(PortError, "ft", "cannot be read", "counts_per_n"):
        at({"port": 9}, monkeypatch).open()


def test_an_address_that_is_none_is_one_line() -> None:
    for host in ("127.0.0.1:x", "127.0.0.1:99999"):
        with refused(PortError, "ft", host, "HOST:PORT"):
            open_udp("ft", UdpForceSettings(host=host), WallClock())


def test_a_port_at_which_nothing_listens_is_one_line() -> None:
    device = UdpForce("ft", UdpForceSettings(host="127.0.0.1:9", **GIVEN), WallClock())
    with refused(PortError, "ft", "127.0.0.1:9", "powered"):
        device.open()
    assert device._link is None
