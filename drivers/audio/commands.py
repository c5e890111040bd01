"""Commands and stream of the fingers' audio: for driver and mock alike. Pure."""

from dataclasses import replace
from typing import Final

from drivers.audio.oscillator import STEPS_PER_HZ
from drivers.audio.settings import FINGERS, FULL_SCALE, RATE_HZ, STREAM, UNIT
from drivers.core.errors import check_streams, wrong
from drivers.core.messages import Chirp, Command, Excite, Listen, StreamInfo, Tone

CHIRP_MAX_S: Final = 600.0
"""Longest chirp (assumption)."""


def fingers_info(name: str) -> StreamInfo:
    """The stream of a device's fingers: 24-bit counts."""
    return StreamInfo(f"{name}.{STREAM}", FINGERS, UNIT, 1.0 / FULL_SCALE, float(RATE_HZ), noisy=True)


def checked(name: str, command: Command) -> Command:
    """A command as the fingers' audio will carry it out: its frequencies in whole millihertz.

    Raises:
        CommandError: it cannot.
    """
    match command:
        case Listen():
            check_streams(name, command, command.streams, (f"{name}.{STREAM}",))
            return command
        case Excite():
            if command.on:
                advice = "send a Tone; Excite off silences the drive"
                raise wrong(name, command, "it gives no frequency", advice)
            return command
        case Tone():
            _check_drive(name, command, command.frequency_hz)
            return replace(command, frequency_hz=_whole(command.frequency_hz))
        case Chirp():
            _check_drive(name, command, command.from_hz, command.to_hz)
            if not 0.0 < command.duration_s <= CHIRP_MAX_S:
                reason = f"{command.duration_s:g} s is out of range"
                raise wrong(name, command, reason, f"choose up to {CHIRP_MAX_S:g} s")
            return replace(command, from_hz=_whole(command.from_hz), to_hz=_whole(command.to_hz))
    advice = "audio can Tone, Chirp, Excite off and Listen"
    raise wrong(name, command, "it has no such command", advice)


def _check_drive(name: str, command: Tone | Chirp, *frequencies_hz: float) -> None:
    # Written so that NaN is out of range too.
    for frequency_hz in frequencies_hz:
        if not 0.0 < frequency_hz < RATE_HZ / 2:
            reason = f"{frequency_hz:g} Hz is out of range"
            raise wrong(name, command, reason, f"choose below {RATE_HZ / 2:g} Hz")
    if not 0.0 < command.level <= 1.0:
        raise wrong(
            name, command, f"a level of {command.level:g} is out of range", "choose from above 0 to 1"
        )


def _whole(frequency_hz: float) -> float:
    return round(frequency_hz * STEPS_PER_HZ) / STEPS_PER_HZ
