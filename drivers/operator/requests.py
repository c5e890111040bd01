"""Requests to a person: their limits and text, and the stream of the loads that hang."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from pydantic import Field

from drivers.core.errors import CommandError
from drivers.core.messages import Ask, Command, LoadWeight, SampleBlock, StreamInfo
from drivers.core.settings import Settings

BRIDGES: Mapping[str, str] = {"x": "Fx", "y": "Fy", "t": "Ft"}
"""The bridges of the fingertip, and the force that each reads."""


class LoadLimits(Settings):
    """The most that a person may be asked to hang on a bridge."""

    limit_x_n: float = Field(default=10.0, gt=0.0, le=1000.0)
    """On Fx, N (Fernandez et al., 4.2: never beyond 10 N)."""

    limit_y_n: float = Field(default=10.0, gt=0.0, le=1000.0)
    """On Fy, N (likewise)."""

    limit_t_n: float = Field(default=1.5, gt=0.0, le=1000.0)
    """On Ft, N (4.2: never beyond 1.5 N)."""


def valid(device: str, limits: LoadLimits, command: Command) -> Ask | LoadWeight:
    """The command, if a person can be asked for it.

    Args:
        device: Name in the profile.
        limits: The most that may hang.
        command: As asked for.

    Raises:
        CommandError: not for a person, without text, or a load that the sensor does not bear.
    """
    doing = f"applying {type(command).__name__}"
    if command.device != device:
        raise CommandError(device, doing, f"it is for {command.device}", f"send it to {command.device}")
    match command:
        case Ask(request=request):
            if not request.strip():
                raise CommandError(device, doing, "it has no text", "write what is to be done")
            return command
        case LoadWeight(bridge=bridge, force_n=force_n):
            if bridge not in BRIDGES:
                known = ", ".join(BRIDGES)
                raise CommandError(device, doing, f"there is no bridge {bridge}", f"choose one of {known}")
            limit_n = {"x": limits.limit_x_n, "y": limits.limit_y_n, "t": limits.limit_t_n}[bridge]
            # Written so that NaN is out of range too.
            if not 0.0 <= force_n <= limit_n:
                reason = f"{force_n:g} N on {BRIDGES[bridge]} is out of range"
                raise CommandError(device, doing, reason, f"choose from 0 to {limit_n:g} N")
            return command
    raise CommandError(device, doing, "a person has no such command", "a person can Ask and LoadWeight")


def request_text(command: Ask | LoadWeight) -> str:
    """The request as a person reads it."""
    if isinstance(command, Ask):
        return command.request
    if command.force_n == 0.0:
        return "take every weight off"
    # Steps of a hundredth of a newton are the finest that a ladder of weights has.
    decimals = max(2, -math.floor(math.log10(command.force_n) + 1e-9) + 1)
    return f"hang {command.force_n:.{decimals}f} N on bridge {BRIDGES[command.bridge]}"


def load_stream(device: str) -> StreamInfo:
    """The stream of what hangs on the fingertip, as the person confirms it: a sample at each change."""
    return StreamInfo(f"{device}.load", tuple(BRIDGES.values()), "N")


class Loads:
    """Makes the stream of loads.

    Args:
        device: Name in the profile.
    """

    def __init__(self, device: str) -> None:
        self._info = load_stream(device)
        self._listening = False
        self._seq = 0
        self._blocks: list[SampleBlock] = []

    def listen(self, streams: frozenset[str]) -> None:
        """Send what changes from now on, or nothing."""
        self._listening = self._info.name in streams

    def hang(self, t_s: float, bridge: str, force_n: float) -> None:
        """This hangs since `t_s`, and nothing else."""
        if self._listening:
            values = np.array([[force_n if name == bridge else 0.0 for name in BRIDGES]])
            times_s = np.array([t_s])
            self._blocks.append(
                self._info.block(self._seq, t_s, values, times_s=times_s, device_t0_s=t_s, arrival_s=t_s)
            )
        self._seq += 1

    def take(self) -> list[SampleBlock]:
        """The blocks since the last call."""
        taken, self._blocks = self._blocks, []
        return taken
