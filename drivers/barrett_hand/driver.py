"""The BarrettHand's finger torques, asked for on a CAN bus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, Strict

from drivers.barrett_hand import codec
from drivers.barrett_hand.strain import Strain, StrainSettings
from drivers.can_link import Beat, CanLink, CanPort, Heard, open_can
from drivers.clock import Clock
from drivers.errors import CommandError, PortError, ProtocolError, SilentError
from drivers.messages import (
    Applied,
    Command,
    DeviceInfo,
    Failed,
    Listen,
    Lost,
    Refused,
    SampleBlock,
    Sent,
    Status,
    Tare,
)
from drivers.numbering import Runs, Track, host_clock

OPEN_TURN_S = 0.001
"""Pause between two looks at the bus while opening (assumption: several frames long)."""

OPEN_ATTEMPTS = 10
"""How often a finger is asked while opening (assumption: frames may be lost, and a busy machine may sleep through
some)."""


class _Answer(NamedTuple):
    """What a finger answered to a beat."""

    beat: int
    due_s: float
    arrival_s: float
    counts: int


class BarrettHandSettings(CanPort, StrainSettings):
    """A BarrettHand on a CAN bus."""

    fingers: Annotated[tuple[int, ...], Strict(False)] = codec.FINGERS
    """Nodes of the fingers that have a strain gauge (interface page)."""
    poll_hz: float = Field(default=1000.0, ge=1.0, le=1000.0)
    """How often the gauges are asked for; what the bus does not carry is lost, and told (the paper: 1 kHz)."""
    answer_timeout_s: float = Field(default=0.02, gt=0.0, le=1.0)
    """When an answer counts as lost. Assumption: the longest delay measured on a pty is 16 ms."""
    silence_timeout_s: float = Field(default=0.5, gt=0.0, le=30.0)
    """Silence after which the hand has failed (assumption: 25 lost answers)."""


class BarrettHand:
    """A hand whose fingers' torques are heard; implements `drivers.protocols.Device`. It moves nothing.

    The link's thread asks at a steady beat, all fingers with one question, or one finger by itself where one alone is
    listened to. Sample k is dated at its beat, `poll_hz` times k; it was asked for there or up to half a period
    later. A beat that the bus or the host was too slow for is a jump in the sequence, told as `Lost`.
    A finger that leaves the range in which the hand works is told as `Saturated`. `Tare` makes what a finger
    reads its zero.

    Streams: `<name>.strain_<finger>` in N at the fingertip, from the maker's rough figure until calibrated.

    Args:
        name: Name in the profile.
        settings: Of the hand.
        clock: Gives bench time.
    """

    def __init__(self, name: str, settings: BarrettHandSettings, clock: Clock) -> None:
        self.name = name
        self._settings = settings
        self._clock = clock
        gauge = StrainSettings(newton_per_count=settings.newton_per_count, zero_counts=settings.zero_counts)
        self._strains = {finger: Strain(name, finger, settings.poll_hz, gauge) for finger in settings.fingers}
        self._fingers = {strain.info.name: finger for finger, strain in self._strains.items()}
        self._link: CanLink | None = None
        self._failed = False
        self._statuses: list[Status] = []
        self._blocks: list[SampleBlock] = []
        self._lost = 0
        self._forget()

    def _forget(self) -> None:
        self._heard: frozenset[int] = frozenset()
        self._heard_s = self._clock.monotonic_s()
        self._tracks = {
            finger: Track(host_clock(), self._settings.poll_hz) for finger in self._settings.fingers
        }

    def open(self) -> DeviceInfo:
        """Connect and read every finger once.

        Raises:
            PortError: the bus is absent, busy or was taken away.
            SilentError: a finger does not answer.
            ProtocolError: what comes is no BarrettHand's.
        """
        self.close()
        self._forget()
        self._failed = False
        self._link = open_can(self.name, self._settings, self._clock)
        try:
            readings = {finger: self._reading(self._link, finger) for finger in self._settings.fingers}
        except BaseException:
            self.close()
            raise
        return DeviceInfo(
            self.name,
            model="BarrettHand",
            streams={strain.info.name: strain.info for strain in self._strains.values()},
            clock="host monotonic",
            details={"readings_counts": readings, "safe_counts": codec.SAFE_COUNTS},
        )

    def close(self) -> None:
        """Ask no more, let go of the bus. Never raises; may be called twice."""
        link, self._link = self._link, None
        if link is not None:
            link.ask(None)
            link.close()

    def apply(self, command: Command) -> Applied:
        """Listen to fingers, or tare one.

        Raises:
            CommandError: not for this hand. Nothing was sent.
        """
        match command:
            case Listen(streams=streams):
                self._listen(frozenset(self._finger(command, stream) for stream in streams))
            case Tare(stream=stream):
                tared = self._strains[self._finger(command, stream)].tare()
                now_s = self._clock.now()
                reason = "nothing has been read of it; listen to it first"
                self._statuses.append(
                    Sent(now_s, self.name, command) if tared else Refused(now_s, self.name, command, reason)
                )
            case _:
                advice = "a hand can Listen and Tare"
                raise CommandError(
                    self.name, f"applying {type(command).__name__}", "it has no such command", advice
                )
        return Applied(command, self._clock.now())

    def read(self) -> Sequence[SampleBlock]:
        """Blocks that have arrived since the last call, in order for each stream."""
        self._turn()
        blocks, self._blocks = self._blocks, []
        return blocks

    def poll(self) -> Sequence[Status]:
        """Statuses since the last call, in order."""
        self._turn()
        statuses, self._statuses = self._statuses, []
        return statuses

    def account(self) -> Mapping[str, object]:
        """How the bus did so far, for the manifest."""
        malformed = 0 if self._link is None else self._link.malformed
        zeros = {strain.info.name: strain.zero for strain in self._strains.values()}
        return {"lost": self._lost, "malformed": malformed, "zero_counts": zeros}

    def _finger(self, command: Command, stream: str) -> int:
        if stream not in self._fingers:
            doing = f"applying {type(command).__name__}"
            advice = f"it has: {', '.join(sorted(self._fingers))}"
            raise CommandError(self.name, doing, f"it has no stream {stream}", advice)
        return self._fingers[stream]

    def _listen(self, fingers: frozenset[int]) -> None:
        link = self._link
        if link is None or fingers == self._heard:
            return
        self._turn()
        self._heard = fingers
        self._heard_s = self._clock.monotonic_s()
        for finger in fingers:  # another question has another grid of beats
            self._tracks[finger].begin()
            self._strains[finger].forget()
        if not fingers:
            link.ask(None)
            return
        if len(fingers) == 1:
            question = codec.Get(min(fingers), codec.Property.STRAIN)
        else:
            question = codec.Get(codec.HAND, codec.Property.STRAIN, group=True)
        link.ask(
            Beat(
                codec.encode_request(question),
                answers=frozenset(codec.reply_id(finger) for finger in fingers),
                period_s=1.0 / self._settings.poll_hz,
                answer_s=self._settings.answer_timeout_s,
            )
        )

    def _turn(self) -> None:
        link = self._link
        if link is None or self._failed:
            return
        answers = {finger: list[_Answer]() for finger in sorted(self._heard)}
        for heard in link.receive():
            reply = _strain(heard)
            if reply is None or reply.sender not in answers or heard.beat is None or heard.due_s is None:
                continue  # another's, or an answer that came too late to say to which question
            answers[reply.sender].append(_Answer(heard.beat, heard.due_s, heard.arrival_s, reply.value))
        now_s = self._clock.monotonic_s()
        if any(answers.values()) or not self._heard:
            self._heard_s = now_s
        for finger, taken in answers.items():
            self._take(finger, taken)
        if link.fault is not None:
            self._fail(link.fault)
        elif now_s - self._heard_s > self._settings.silence_timeout_s:
            self._fail(f"no answer in {self._settings.silence_timeout_s:g} s; is the hand powered?")

    def _take(self, finger: int, answers: Sequence[_Answer]) -> None:
        """Make blocks of what a finger answered."""
        strain, runs, lost = self._strains[finger], Runs[int](), 0
        for beat, due_s, arrival_s, counts in answers:
            placed = self._tracks[finger].place(due_s, arrival_s, counter=beat, joins=bool(runs))
            lost += placed.lost or 0
            runs.push(placed.seq, placed.t0_s, arrival_s, counts)
        for run in runs.take():
            t0_s, arrival_s = (self._clock.from_monotonic(s) for s in (run.t0_s, run.arrival_s))
            block = strain.block(run.seq, t0_s, np.array(run.samples, dtype=np.int64), arrival_s)
            self._blocks.append(block)
            self._statuses += strain.saturation(block)
        if lost:
            self._lost += lost
            self._statuses.append(Lost(self._clock.now(), self.name, strain.info.name, lost))

    def _fail(self, reason: str) -> None:
        self._failed = True
        self._statuses.append(Failed(self._clock.now(), self.name, reason))

    def _reading(self, link: CanLink, finger: int) -> int:
        """Ask one finger until it answers.

        Raises:
            PortError: the bus was taken away.
            SilentError: it does not answer.
            ProtocolError: what comes is no BarrettHand's.
        """
        strangers = 0
        for _ in range(OPEN_ATTEMPTS):
            link.send(codec.encode_request(codec.Get(finger, codec.Property.STRAIN)))
            until_s = self._clock.monotonic_s() + self._settings.answer_timeout_s
            while self._clock.monotonic_s() < until_s and link.fault is None:
                for heard in link.receive():
                    reply = _strain(heard)
                    strangers += reply is None
                    if reply is not None and reply.sender == finger:
                        return reply.value
                self._clock.rest(OPEN_TURN_S)
        doing = f"asking finger {finger} at {self._settings.port}"
        if link.fault is not None:
            raise PortError(self.name, doing, link.fault, "is the adapter plugged in?")
        if strangers or link.malformed:
            reason = f"{strangers} frames of others and {link.malformed} malformed ones came, and no answer"
            raise ProtocolError(self.name, doing, reason, "is a BarrettHand on this bus, at its bit rate?")
        waited_s = OPEN_ATTEMPTS * self._settings.answer_timeout_s
        raise SilentError(self.name, doing, f"no answer in {waited_s:g} s", "is the hand powered?")


def _strain(heard: Heard) -> codec.Reply | None:
    """What a finger's gauge reads; None where this is something else."""
    try:
        reply = codec.decode_reply(heard.frame)
    except codec.CodecError:
        return None
    return reply if reply.property == codec.Property.STRAIN else None
