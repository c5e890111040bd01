"""What a sensor board refuses of a command, whoever makes the board: the same on the mock bench. Pure."""

from __future__ import annotations

from pydantic import Field

from drivers.errors import CommandError
from drivers.messages import Command, SetTendon
from drivers.settings import Settings


class BoardLimits(Settings):
    """How far a board may set the finger's tendon."""

    tendon_min_m: float = Field(default=0.0, ge=-0.1, le=0.1)
    """Least tendon position; 0 is the finger extended."""
    tendon_max_m: float = Field(default=0.02, ge=-0.1, le=0.1)
    """Greatest tendon position (assumption: the finger's tendon travel)."""


def mine(device: str, command: Command) -> Command:
    """The command, where it is for this board.

    Raises:
        CommandError: it is for another device.
    """
    if command.device != device:
        raise wrong(device, command, f"it is for {command.device}", f"send it to {command.device}")
    return command


def tendon_um(device: str, limits: BoardLimits, command: SetTendon) -> int:
    """The tendon's position in whole micrometres.

    Raises:
        CommandError: not finite, or out of range.
    """
    position_m, least_m, most_m = command.position_m, limits.tendon_min_m, limits.tendon_max_m
    # Written so that NaN is out of range too.
    if not least_m <= position_m <= most_m:
        advice = f"choose from {least_m:g} to {most_m:g} m"
        raise wrong(device, command, f"{position_m:g} m is out of range", advice)
    return round(position_m * 1e6)


def wrong(device: str, command: Command, reason: str, advice: str) -> CommandError:
    """The error of a command that a board cannot take."""
    return CommandError(device, f"applying {type(command).__name__}", reason, advice)
