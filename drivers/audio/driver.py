"""The fingers' sound: carrier in, drive out; from a sound card, a file or a recorder on the network."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.audio.codec import Sound
from drivers.audio.commands import checked, fingers_info
from drivers.audio.quality import Excursions, Stillness, clipped, flaw
from drivers.audio.settings import FINGERS, FULL_SCALE, RATE_HZ, AudioSettings
from drivers.audio.source import SoundSource, SourceEvent, SourceFound, Swept, make_source
from drivers.core.clock_model import DeviceClock
from drivers.core.errors import PortError, ProtocolError, SilentError
from drivers.core.messages import (
    Chirp,
    Command,
    DeviceInfo,
    Excite,
    Listen,
    Reached,
    Refused,
    Saturated,
    Status,
    Tone,
)
from drivers.core.numbering import ENDLESS, StreamTrack
from drivers.core.wire import TURN_S, WireDriver

BITS_MIN: Final = 24
"""Of a sample: the fingers' sound moves by less than 16 bits resolve (III.B: a 24-bit converter)."""

TURN_MAX_S: Final = 0.05
"""A turn that comes later counts as this: a host that was away must not blame the source (assumption)."""

MENDING: Final = "see docs/reference/sensors.md"


class Audio(WireDriver[SoundSource]):
    """The fingers' sound. It moves nothing.

    The stream `<name>.fingers` has raw 24-bit counts of the right and the left finger. Its `seq` counts the frames of
    the converter, which also drives: a tone's phase is zero at frame 0 (`level * cos(2 pi f seq / rate)`, but for
    the constant delay of the converters), so that `seq` is the in-phase reference. Overrun or lost frames are a gap
    in `seq`, reported as `Lost`. Times come from the converter's clock (`numbering`).

    A finger at full scale is reported as `Saturated` at each excursion. Clipped, silent or 16-bit sound is refused at
    `open`; a finger that falls silent later, a recording that ends and a source that goes away have failed.
    """

    _settings: AudioSettings
    _opens = staticmethod(make_source)

    def _prepare(self) -> None:
        self._info = fingers_info(self.name)
        self._source: SoundSource | None = None  # the latest, whose counts outlive it
        self._forget()

    def _forget(self) -> None:
        s = self._settings
        self._converter = DeviceClock(s.max_drift_ppm)
        self._track = StreamTrack(self._converter, float(RATE_HZ), ENDLESS)
        self._taken = self._missing = 0  # frames
        self._last = -1  # frame
        self._excursions = Excursions(RATE_HZ)
        self._stillness = Stillness(RATE_HZ, s.silence_timeout_s)
        self._listening = False
        self._saturations = 0
        self._driven = 0  # id of the last drive command
        self._turned_s = self._clock.monotonic_s()
        self._silent_s = 0.0

    def _identify(self, source: SoundSource) -> DeviceInfo:
        """Check the source and a sample of its sound; clipped, silent or 16-bit sound is refused."""
        self._source, found = source, source.open()
        self._check(found)
        if self._settings.look_s > 0.0:
            self._look(source, found)
        self._turned_s = self._clock.monotonic_s()
        return DeviceInfo(
            self.name,
            model=found.model,
            serial=found.serial,
            version=found.version,
            streams={self._info.name: self._info},
            clock=found.clock,
            details={
                "port": self._settings.port,
                "bits": found.bits or "not reported",
                "channels": dict(zip(FINGERS, self._settings.channels, strict=True)),
                **found.details,
            },
        )

    def _valid(self, command: Command) -> Command:
        return checked(self.name, command)

    def _carry_out(self, command: Command) -> None:
        assert self._link is not None
        if isinstance(command, Listen):
            self._listen(bool(command.streams), self._link)
        elif isinstance(command, Tone | Chirp | Excite):
            self._turn()  # a chirp whose end has come by now is the one before
            if self._failure is not None and not isinstance(command, Excite):
                self._refuse(command, self._failure)
                return
            self._link.drive(command)
            self._driven = command.id
        self._sent(command)

    def poll(self) -> Sequence[Status]:
        """Statuses since the last call, in order."""
        if (
            self._listening
        ):  # `read` processes the sound, so that none is left behind the end that is reported here
            statuses, self._statuses = self._statuses, []
            return statuses
        return super().poll()

    def account(self) -> Mapping[str, object]:
        """Frames taken and lost, excursions to full scale, the drift of the converter's clock: also after `close`."""
        if self._source is None:
            return {}
        return {
            "frames": self._taken,
            "frames_lost": self._missing,
            "saturations": self._saturations,
            "drift_ppm": self._converter.drift_ppm,
            **self._source.account(),
        }

    # at open

    def _check(self, found: SourceFound) -> None:
        """Check what the source reports of itself."""
        doing, needed = "opening", max(*self._settings.channels, 1) + 1
        if found.channels < needed:
            has = f"{found.what} has {found.channels} channel{'s' if found.channels > 1 else ''}"
            reason = f"{has} where two fingers need {needed}"
            raise ProtocolError(self.name, doing, reason, "record both fingers, and set `channels`")
        if found.rate_hz != RATE_HZ:
            reason = f"{found.what} has {found.rate_hz:g} frames a second, not {RATE_HZ}"
            raise ProtocolError(self.name, doing, reason, f"record at {RATE_HZ} Hz: 40 kHz are wanted of it")
        if found.bits is not None and found.bits < BITS_MIN:
            reason = f"{found.what} has {found.bits} bits a sample, not {BITS_MIN}"
            raise ProtocolError(self.name, doing, reason, "choose a 24-bit format")

    def _look(self, source: SoundSource, found: SourceFound) -> None:
        """Look at a sample of the sound; refuse it where clipped, silent or coarse."""
        counts = source.peek(self._settings.look_s)
        if counts is None:
            counts = self._gather(source, found)
        if len(counts):
            wrong = flaw(counts[:, list(self._settings.channels)], len(counts) / RATE_HZ)
            if wrong is not None:
                reason, advice = wrong
                raise ProtocolError(self.name, f"listening to {found.what}", reason, advice)

    def _gather(self, source: SoundSource, found: SourceFound) -> NDArray[np.int32]:
        wanted = round(self._settings.look_s * RATE_HZ)
        until_s = self._clock.monotonic_s() + self._settings.look_s + self._settings.silence_timeout_s
        received: list[NDArray[np.int32]] = []
        source.listen(True)
        while (
            sum(map(len, received)) < wanted and source.fault is None and self._clock.monotonic_s() < until_s
        ):
            self._clock.rest(TURN_S)
            for one in source.receive():
                if isinstance(one, Sound):
                    last = one.frame + len(one.counts) - 1
                    self._converter.observe(last / RATE_HZ, one.arrival_s)
                    received.append(one.counts)
        source.listen(False)
        doing = f"listening to {found.what}"
        if source.fault is not None:
            raise PortError(self.name, doing, source.fault, MENDING)
        if not received:
            reason = f"no sound in {self._settings.look_s + self._settings.silence_timeout_s:g} s"
            raise SilentError(self.name, doing, reason, "is it running?")
        return np.concatenate(received)

    # while it runs

    def _listen(self, on: bool, source: SoundSource) -> None:
        if on == self._listening:
            return
        self._turn()
        self._listening = on
        self._silent_s = 0.0
        self._track.begin()
        self._excursions.begin()
        self._stillness.begin()
        source.listen(on)

    def _update(self, source: SoundSource) -> str | None:
        """Process what has arrived; check for silence."""
        now_s = self._clock.monotonic_s()
        passed_s, self._turned_s = min(now_s - self._turned_s, TURN_MAX_S), now_s
        self._silent_s = self._silent_s + passed_s if self._listening else 0.0
        for event in source.receive():
            self._take(event)
        limit_s = self._settings.silence_timeout_s
        return f"no sound in {limit_s:g} s; is the source running?" if self._silent_s > limit_s else None

    def _take(self, event: SourceEvent) -> None:
        if isinstance(event, Swept):
            arrival_s = event.arrival_s
            if self._converter.ready:
                arrival_s = min(self._converter.host_s(event.frame / RATE_HZ), arrival_s)
            t_s = self._clock.from_monotonic(arrival_s)
            self._report(Reached(t_s, self.name, 0.0, command_id=self._driven))
        elif isinstance(event, Refused):
            self._report(event)
        elif self._listening and self._failure is None:
            self._silent_s = 0.0
            self._receive(event)

    def _receive(self, sound: Sound) -> None:
        n, device_s = len(sound.counts), sound.frame / RATE_HZ
        placed = self._track.place(device_s, sound.arrival_s, n)
        if sound.frame <= self._last or self._converter.restarts:
            # The counter went back, or far ahead of the time that has passed: with it goes the drive's phase.
            self._fail(f"the converter began anew: after frame {self._last} came {sound.frame}")
            return
        self._last = sound.frame + n - 1
        self._taken += n
        lost, bench_s = placed.lost or 0, self._clock.from_monotonic(0.0)
        self._missing += lost
        counts = np.ascontiguousarray(sound.counts[:, list(self._settings.channels)])
        block = self._info.block(
            sound.frame,
            placed.t0_s + bench_s,
            counts,
            device_t0_s=device_s,
            arrival_s=sound.arrival_s + bench_s,
        )
        if lost:
            self._lost(block.t0_s, block.stream, lost)
        self._blocks.append(block)
        for place, finger in self._excursions.push(clipped(counts)):
            self._saturations += 1
            t_s, value = block.t0_s + place / RATE_HZ, float(counts[place, finger]) / FULL_SCALE
            self._report(Saturated(t_s, self.name, block.stream, value))
        silent = self._stillness.push(counts)
        if silent is not None:
            waited_s = self._settings.silence_timeout_s
            self._fail(
                f"the {silent} finger is silent: nothing has moved in {waited_s:g} s; is it plugged in?"
            )


__all__ = ["Audio", "AudioSettings"]
