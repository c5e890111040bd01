"""A six-axis force sensor behind a Net F/T box: forces, torques, and the force along one axis."""

import math
import socket
import threading
import urllib.request
from collections import deque
from collections.abc import Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from drivers.core.clock import Clock
from drivers.core.clock_model import DeviceClock, HostClock
from drivers.core.errors import CodecError, PortError, ProtocolError, RefusedError
from drivers.core.links import JOIN_TIMEOUT_S, drained
from drivers.core.messages import Command, DeviceInfo, Listen, Saturated, StreamInfo, Tare
from drivers.core.numbering import SampleStream
from drivers.core.settings import Address, Settings
from drivers.core.wire import OPENING_S, Inquiry, WireDriver, check_sensor
from drivers.udp_force import codec
from drivers.udp_force.codec import BoxSettings, ForceRecord

LOOK_S = 0.1
"""How long one wait for a datagram lasts: closing may take so long (assumption)."""

ON_THE_WAY_S = 0.05
"""How long after a start records of the series before it may still come (assumption: a busy host's queue)."""

PAGE = "http://{}/netftapi2.xml"
"""Where the box's settings are."""

DATAGRAM = 65_536
"""Bytes that are taken at once: any datagram."""

TAKEN_S = 0.05
"""How long after a tare its zero shows, and how long the level after it is averaged (assumption)."""

TARED_N = 1.0
"""Force that a tare may leave (assumption: drift, and the noise of such an average)."""


class UdpForceSettings(Settings):
    """The box, and how its sensor is mounted."""

    host: Address
    """Address of the box, as `192.168.1.1`; another UDP port than 49152 behind a colon."""
    make: Literal["net_ft", "axia"] = "net_ft"
    """Whose status word it sends: ATI's Net F/T's, as OnRobot's, or its Axia's."""
    normal: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = "-z"
    """Axis of the sensor along which the stream `normal` is positive: "-z" where a push on the tool is."""
    counts_per_n: float | None = Field(default=None, gt=0.0)
    """Counts for each newton; "none": read from the box's page of settings, `http://ADDRESS/netftapi2.xml`."""
    counts_per_nm: float | None = Field(default=None, gt=0.0)
    """Likewise for each newton metre."""
    rate_hz: float | None = Field(default=None, gt=0.0, le=10_000.0)
    """Records a second, as set in the box; "none": read from there."""
    sample_hz: float | None = Field(default=None, gt=0.0, le=100_000.0)
    """Samples a second by the sensor's own clock, 7000 of a Net F/T; "none": read from there."""
    reply_timeout_s: float = Field(default=0.5, gt=0.0, le=10.0)
    """When it is asked again (assumption)."""
    silence_timeout_s: float = Field(default=0.2, gt=0.0, le=60.0)
    """Silence after which it has failed (assumption: tens of records)."""
    max_drift_ppm: float = Field(default=200.0, gt=0.0, le=10_000.0)
    """Bound on the drift between its clock and the host's. Assumption: two crystals of 100 ppm."""


class UdpLink:
    """A UDP socket to one host, with a thread that time-stamps what arrives; as `SerialLink`."""

    def __init__(self, device: str, connected: socket.socket, clock: Clock) -> None:
        self.fault: str | None = None
        self._clock = clock
        self._arrived: deque[tuple[float, bytes]] = deque()
        self._closing = False
        self._socket = connected
        self._socket.settimeout(LOOK_S)
        self._reader = threading.Thread(target=self._fill, name=f"{device}-reader", daemon=True)
        self._reader.start()

    def send(self, data: bytes) -> float | None:
        """Hand a datagram to the kernel; returns when, in monotonic seconds, None where the link is gone."""
        try:
            self._socket.send(data)
        except OSError as error:
            self.fault = self.fault or f"nothing takes what is sent ({error.strerror or error})"
        return None if self.fault else self._clock.monotonic_s()

    def receive(self) -> list[tuple[float, bytes]]:
        """What has arrived since the last call: (monotonic arrival in seconds, a datagram), in order."""
        return drained(self._arrived)

    def close(self) -> None:
        """Close it and wait for the thread. Never raises; may be called twice."""
        self._closing = True
        self._reader.join(JOIN_TIMEOUT_S)
        self._socket.close()

    def _fill(self) -> None:
        while not self._closing:
            try:
                data = self._socket.recv(DATAGRAM)
                self._arrived.append((self._clock.monotonic_s(), data))
            except TimeoutError:
                pass
            except OSError as error:
                if not self._closing:
                    self.fault = self.fault or f"nothing listens there ({error.strerror or error})"
                return


def open_udp(device: str, where: UdpForceSettings, clock: Clock) -> UdpLink:
    """A link to the box; raises `PortError`: no such address."""
    host, _, port = where.host.partition(":")
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        opened.connect((host, int(port or codec.PORT)))
        return UdpLink(device, opened, clock)
    except (OSError, ValueError, OverflowError) as error:
        opened.close()
        raise PortError(
            device,
            "opening its link",
            f"{where.host} is no address ({error})",
            "as 192.168.1.1, or HOST:PORT",
        ) from error


class UdpForce(WireDriver[UdpLink]):
    """A Net F/T box. It moves nothing.

    Streams: `<name>.force` (x, y, z in N), `<name>.torque` (x, y, z in N m), `<name>.normal` (N).
    """

    _settings: UdpForceSettings
    _opens = staticmethod(open_udp)

    def account(self) -> Mapping[str, object]:
        """Datagrams that made no sense, records that came behind a later one, and the drift of the box's clock."""
        found = {"malformed": self._malformed, "disordered": self._disordered}
        return {**found, **self._own_clock.account(self.name)}

    def _prepare(self) -> None:
        self._forget()

    def _forget(self) -> None:
        self._malformed = self._disordered = 0
        self._listening = frozenset[str]()
        self._streams: dict[str, SampleStream] = {}
        self._own_clock: DeviceClock = HostClock()
        self._received_s = 0.0
        self._latest: int | None = None
        self._old = False
        self._tare: tuple[Tare, float, list[float]] | None = None
        """The last one, when it was sent, and the forces after it."""
        self._saturated: set[str] = set()
        """Streams whose excursion has been reported."""

    def _identify(self, link: UdpLink) -> DeviceInfo:
        s = self._settings
        inquiry = Inquiry(
            self.name,
            f"asking for a record at {s.host}",
            link,
            self._clock,
            s.reply_timeout_s,
            strange=lambda: (
                f"{self._malformed} datagrams that are no records arrived" * bool(self._malformed)
            ),
            stranger="is another device at this address?",
            silent="is the box powered, is this its address, and RDT enabled in it?",
        )
        link.send(codec.encode_request("stop"))  # an earlier host may have left it on
        first = inquiry.ask(lambda: link.send(codec.encode_request("start", 1)), self._first)
        if fault := codec.faults_of(first.status, s.make):
            raise RefusedError(
                self.name, "reading its status", fault, "switch it off and on; see its own pages"
            )
        box = self._box()
        axis, sign = "xyz".index(s.normal[1]), -1 if s.normal[0] == "-" else 1
        self._normal = axis, sign
        clock = self._own_clock = DeviceClock(s.max_drift_ppm, wrap_s=codec.MODULUS / box.sample_hz)
        self._sample_hz = box.sample_hz
        xyz, n, nm = ("x", "y", "z"), 1.0 / box.counts_per_n, 1.0 / box.counts_per_nm
        infos = (
            StreamInfo(f"{self.name}.force", xyz, "N", n, box.rate_hz, noisy=True),
            StreamInfo(f"{self.name}.torque", xyz, "N m", nm, box.rate_hz, noisy=True),
            StreamInfo(f"{self.name}.normal", (s.normal,), "N", n, box.rate_hz, noisy=True),
        )
        self._streams = {
            info.name: SampleStream(info, clock, self._clock, np.int32, codec.MODULUS) for info in infos
        }
        return DeviceInfo(
            self.name,
            "Net F/T",
            streams={info.name: info for info in infos},
            clock=f"{self.name}'s own",
            details={"host": s.host, "status": f"{first.status:08x}", **box._asdict()},
        )

    def _box(self) -> BoxSettings:
        """The profile's settings of the box, or its own; raises a `DeviceError`."""
        s = self._settings
        given = (s.counts_per_n, s.counts_per_nm, s.rate_hz, s.sample_hz)
        if None not in given:
            return BoxSettings(*(value or 0.0 for value in given))
        url, doing = PAGE.format(s.host.partition(":")[0]), "reading the box's settings"
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))  # it is in this network
        try:
            with opener.open(url, timeout=max(s.reply_timeout_s, OPENING_S)) as page:
                box = codec.decode_settings(page.read().decode("utf-8", "replace"))
        except CodecError as error:
            raise ProtocolError(
                self.name, doing, f"{url}: {error}", "give counts_per_n, counts_per_nm, rate_hz and sample_hz"
            ) from None
        except OSError as error:
            raise PortError(
                self.name,
                doing,
                f"{url} cannot be read ({error})",
                "open it in a browser; or give counts_per_n, counts_per_nm, rate_hz and sample_hz",
            ) from error
        return BoxSettings(*(value or own for value, own in zip(given, box, strict=True)))

    def _leave(self, link: UdpLink, failure: str | None) -> None:
        link.send(codec.encode_request("stop"))

    def _valid(self, command: Command) -> Command:
        return check_sensor(self.name, command, self._streams)

    def _carry_out(self, command: Command) -> None:
        assert self._link is not None
        if isinstance(command, Tare):
            sent_s = self._link.send(codec.encode_request("bias", codec.ZERO_HERE))
            self._sent(command, sent_s)
            self._tare = None if sent_s is None else (command, sent_s, [])
        elif isinstance(command, Listen) and command.streams != self._listening:
            self._tare = None
            for name in command.streams - self._listening:
                self._streams[name].begin()
                self._saturated.discard(name)
            turned, self._listening = bool(command.streams) != bool(self._listening), command.streams
            if turned and command.streams:
                # the box counts anew; what it sent before may be on the way
                self._old = self._latest is not None
                self._received_s = self._clock.monotonic_s()
            request = codec.encode_request("start" if command.streams else "stop")
            self._sent(command, self._link.send(request) if turned else self._clock.monotonic_s())

    def _update(self, link: UdpLink) -> str | None:
        for arrival_s, data in link.receive():
            for record in self._records(data):
                if fault := codec.faults_of(record.status, self._settings.make):
                    return fault
                if self._listening and self._in_order(record, arrival_s):
                    self._received_s = arrival_s
                    self._take(record, arrival_s)
        for stream in self._streams.values():
            self._blocks += stream.take()
        limit_s, silent_s = self._settings.silence_timeout_s, self._clock.monotonic_s() - self._received_s
        silent = bool(self._listening) and silent_s > limit_s
        return f"no record in {limit_s:g} s; is the box powered, and its cable in?" if silent else None

    def _in_order(self, record: ForceRecord, arrival_s: float) -> bool:
        ahead = 1 if self._latest is None else (record.rdt - self._latest) % codec.MODULUS
        onwards = 0 < ahead < codec.MODULUS // 2
        if self._old:
            self._old = onwards and arrival_s - self._received_s < ON_THE_WAY_S
            self._latest = record.rdt
            return not self._old
        if not onwards:
            self._disordered += 1
            return False
        self._latest = record.rdt
        return True

    def _take(self, record: ForceRecord, arrival_s: float) -> None:
        axis, sign = self._normal
        force = record.counts[:3]
        parts = {"force": force, "torque": record.counts[3:], "normal": (sign * force[axis],)}
        for name in sorted(self._listening):
            counts = parts[name.rpartition(".")[2]]
            shown_s = record.ft / self._sample_hz
            t_s, lost = self._streams[name].push(counts, shown_s, arrival_s, record.rdt)
            if lost is not None:
                self._lost(t_s, name, lost)
            if not record.status & codec.STATUS[self._settings.make].saturated:
                self._saturated.discard(name)
            elif name not in self._saturated:
                self._saturated.add(name)
                value = max(map(abs, counts)) * self._streams[name].info.scale
                self._report(Saturated(t_s, self.name, name, value))

        self._check_tare(math.hypot(*force) * self._streams[f"{self.name}.force"].info.scale, arrival_s)

    def _check_tare(self, force_n: float, arrival_s: float) -> None:
        """The box does not answer a tare: its level says whether it was taken."""
        if self._tare is None or arrival_s < self._tare[1] + TAKEN_S:
            return
        command, sent_s, forces_n = self._tare
        forces_n.append(force_n)
        if arrival_s < sent_s + 2.0 * TAKEN_S:
            return
        self._tare, left_n = None, sum(forces_n) / len(forces_n)
        if left_n > TARED_N:
            self._refuse(
                command, f"it still reads {left_n:.3g} N; is the tool at rest, and did the box take it?"
            )

    def _first(self, arrived: tuple[float, bytes]) -> ForceRecord | None:
        return next(iter(self._records(arrived[1])), None)

    def _records(self, data: bytes) -> list[ForceRecord]:
        try:
            return list(codec.decode_records(data))
        except CodecError:
            self._malformed += 1
            return []
