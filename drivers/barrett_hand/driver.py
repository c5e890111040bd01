"""The BarrettHand's finger torques, polled on a CAN bus."""

from collections.abc import Mapping, Sequence

import numpy as np
from pydantic import Field

from drivers.barrett_hand import codec
from drivers.barrett_hand.strain import FingerStrain, FingerStrainSettings
from drivers.core.can_link import CanLink, CanPort, PeriodicQuestion, ReceivedFrame, open_can, strange_frames
from drivers.core.clock_model import HostClock
from drivers.core.errors import CodecError, RefusedError
from drivers.core.messages import Command, DeviceInfo, Listen, Tare
from drivers.core.numbering import ENDLESS, Samples, StreamTrack
from drivers.core.wire import Inquiry, WireDriver, check_sensor

QUIET_S = 0.3
"""How long nothing may be said on the bus while fingers wake (libbarrett)."""


class BarrettHandSettings(CanPort, FingerStrainSettings):
    """A BarrettHand on a CAN bus."""

    answer_timeout_s: float = Field(default=0.02, gt=0.0, le=1.0)
    """When an answer counts as lost. Assumption: the longest delay measured on a pty is 16 ms."""
    wake_s: float = Field(default=1.0, gt=0.0, le=30.0)
    """How long a finger that was switched on may take to wake (assumption: three times libbarrett's first wait)."""
    silence_timeout_s: float = Field(default=0.5, gt=0.0, le=30.0)
    """Silence after which the hand has failed (assumption: 25 lost answers)."""


class BarrettHand(WireDriver[CanLink]):
    """The torques of a hand's fingers. It moves nothing.

    The link's thread polls periodically, all fingers with one query, or a single finger where only one is subscribed.
    Sample k is dated at the start of its cycle, k / `poll_hz`; it was polled then or up to half a period later.
    A cycle that the bus or the host was too slow for is a jump in the sequence, reported as `Lost`. A finger that
    leaves the range in which the hand works is reported as `Saturated`. `Tare` takes a finger's reading as its zero.

    Streams: `<name>.strain_<finger>` in N at the fingertip, from the maker's rough figure until calibrated.
    """

    _settings: BarrettHandSettings
    _opens = staticmethod(open_can)

    def _prepare(self) -> None:
        s = self._settings
        self._strains = {finger: FingerStrain(self.name, finger, s.poll_hz, s) for finger in s.fingers}
        self._fingers = {strain.info.name: finger for finger, strain in self._strains.items()}
        self._missing = 0
        self._forget()

    def _forget(self) -> None:
        self._subscribed: frozenset[int] = frozenset()
        self._received_s = self._clock.monotonic_s()
        self._tracks = {
            finger: StreamTrack(HostClock(), self._settings.poll_hz, ENDLESS)
            for finger in self._settings.fingers
        }

    def _identify(self, link: CanLink) -> DeviceInfo:
        woken = self._wake(link)
        readings = {finger: self._asked(link, finger, codec.STRAIN) for finger in self._settings.fingers}
        return DeviceInfo(
            self.name,
            model="BarrettHand",
            streams={strain.info.name: strain.info for strain in self._strains.values()},
            clock="host monotonic",
            details={"readings_counts": readings, "safe_counts": codec.SAFE_COUNTS, "woken": woken},
        )

    def _wake(self, link: CanLink) -> tuple[int, ...]:
        """Wake the fingers that sleep, as all do after power-up; raises a `DeviceError`."""
        s = self._settings
        asleep = tuple(
            finger for finger in s.fingers if self._asked(link, finger, codec.STATUS) != codec.READY
        )
        for finger in asleep:
            link.send(codec.encode_wake(finger))
        if asleep:
            self._clock.rest(QUIET_S)
            link.receive()  # late answers, of before it was woken
        for finger in asleep:
            if self._asked(link, finger, codec.STATUS, s.wake_s) != codec.READY:
                reason = f"finger {finger} was woken and is not ready"
                raise RefusedError(self.name, "waking it", reason, "switch the hand off and on")
        return asleep

    def _leave(self, link: CanLink, failure: str | None) -> None:
        link.ask(None)

    def _valid(self, command: Command) -> Command:
        return check_sensor(self.name, command, self._fingers, "a hand")

    def _carry_out(self, command: Command) -> None:
        if isinstance(command, Listen):
            self._listen(frozenset(self._fingers[stream] for stream in command.streams))
        elif isinstance(command, Tare) and self._strains[self._fingers[command.stream]].tare():
            self._sent(command)
        else:
            self._refuse(command, "no samples of it yet; listen to it first")

    def zero_setting(self, stream: str) -> str:
        """See `OwnZero.zero_setting`: the fingers have one setting together."""
        zero = self._strains[self._fingers[stream]].zero
        return f"zero_counts = {zero}  # in [devices.{self.name}]" if len(self._strains) == 1 else ""

    def account(self) -> Mapping[str, object]:
        """Samples lost, malformed frames and zeros, for the manifest."""
        malformed = 0 if self._link is None else self._link.malformed
        zeros = {strain.info.name: strain.zero for strain in self._strains.values()}
        return {"lost": self._missing, "malformed": malformed, "zero_counts": zeros}

    def _listen(self, fingers: frozenset[int]) -> None:
        link = self._link
        if link is None or fingers == self._subscribed:
            return
        self._turn()
        self._subscribed = fingers
        self._received_s = self._clock.monotonic_s()
        for finger in fingers:  # another query has another grid of cycles
            self._tracks[finger].begin()
            self._strains[finger].forget()
        if not fingers:
            link.ask(None)
            return
        alone = len(fingers) == 1
        query = codec.encode_query(min(fingers)) if alone else codec.encode_query(codec.HAND, group=True)
        link.ask(
            PeriodicQuestion(
                query,
                answers=frozenset(codec.reading_id(finger) for finger in fingers),
                period_s=1.0 / self._settings.poll_hz,
                answer_s=self._settings.answer_timeout_s,
            )
        )

    def _update(self, link: CanLink) -> str | None:
        answers = {finger: list[tuple[ReceivedFrame, int]]() for finger in sorted(self._subscribed)}
        for received in link.receive():
            sender, counts = _reading(received) or (None, 0)
            if sender in answers and received.due_s is not None:
                answers[sender].append((received, counts))
            # Else it is from another node, or too late to be assigned to a cycle.
        now_s = self._clock.monotonic_s()
        if any(answers.values()) or not self._subscribed:
            self._received_s = now_s
        for finger, taken in answers.items():
            self._take(finger, taken)
        if now_s - self._received_s > self._settings.silence_timeout_s:
            return f"no answer in {self._settings.silence_timeout_s:g} s; is the hand powered?"
        return None

    def _take(self, finger: int, answers: Sequence[tuple[ReceivedFrame, int]]) -> None:
        """Make blocks of what a finger answered."""
        strain, lost = self._strains[finger], 0
        samples = Samples(strain.info, np.int64)
        for received, count in answers:
            assert received.due_s is not None
            placed = self._tracks[finger].place(
                received.due_s, received.arrival_s, counter=received.cycle, joins=bool(samples)
            )
            lost += placed.lost or 0
            samples.push(placed.seq, placed.t0_s, received.arrival_s, (count,))
        for raw in samples.take(self._clock.from_monotonic(0.0)):
            counts = raw.values[:, 0].astype(np.int64)
            block = strain.block(raw.seq, raw.t0_s, counts, raw.arrival_s)
            self._blocks.append(block)
            self._statuses += strain.saturation(block)
        if lost:
            self._missing += lost
            self._lost(self._clock.now(), strain.info.name, lost)

    def _asked(self, link: CanLink, finger: int, subject: int, patience_s: float = 0.0) -> int:
        """Query one finger for a property until it answers; raises a `DeviceError`."""
        strangers = 0

        def parse(received: ReceivedFrame) -> int | None:
            nonlocal strangers
            sender, value = _reading(received, subject) or (None, 0)
            strangers += sender is None
            return value if sender == finger else None

        inquiry = Inquiry(
            self.name,
            f"asking finger {finger} at {self._settings.port}",
            link,
            self._clock,
            self._settings.answer_timeout_s,
            strange=lambda: strange_frames(strangers, link),
            stranger="is a BarrettHand on this bus, at its bit rate?",
            silent="is the hand powered?",
        )
        query = codec.encode_query(finger, subject=subject)
        return inquiry.ask(lambda: link.send(query), parse, patience_s)


def _reading(received: ReceivedFrame, subject: int = codec.STRAIN) -> tuple[int, int] | None:
    """A finger and the property's value; None where this is something else."""
    try:
        return codec.decode_reading(received.frame, subject)
    except CodecError:
        return None
