"""Which commands a sensor board takes and refuses: for driver and mock alike. Pure."""

from collections.abc import Iterable
from dataclasses import replace

from pydantic import Field

from drivers.core.errors import check_streams, wrong
from drivers.core.messages import Command, Excite, Listen, SetTendon, Tare
from drivers.core.settings import Settings


class BoardLimits(Settings):
    """How far a board may set the finger's tendon."""

    tendon_min_m: float = Field(default=0.0, ge=-0.1, le=0.1)
    """Least tendon position; 0 is the finger extended."""
    tendon_max_m: float = Field(default=0.02, ge=-0.1, le=0.1)
    """Greatest tendon position (assumption: the finger's tendon travel)."""

    def checked(self, device: str, streams: Iterable[str], command: Command) -> Command:
        """The command as the board will see it: a tendon's position is rounded to the micrometre.

        Raises:
            CommandError: not for this board, not finite or out of range.
        """
        match command:
            case Excite():
                return command
            case SetTendon(position_m=position_m):
                # Written so that NaN is out of range too.
                if not self.tendon_min_m <= position_m <= self.tendon_max_m:
                    advice = f"choose from {self.tendon_min_m:g} to {self.tendon_max_m:g} m"
                    raise wrong(device, command, f"{position_m:g} m is out of range", advice)
                return replace(command, position_m=round(position_m * 1e6) * 1e-6)
            case Tare(stream=stream):
                check_streams(device, command, (stream,), streams)
                return command
            case Listen():
                check_streams(device, command, command.streams, streams)
                return command
        advice = "a sensor board can Excite, SetTendon, Tare and Listen"
        raise wrong(device, command, "it has no such command", advice)
