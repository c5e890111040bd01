"""The one interface that every device has, mock, emulated or real."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from drivers.core.messages import Command, DeviceInfo, SampleBlock, Status


class Device(Protocol):
    """A device on the bench.

    Nothing here waits but `open` and `close`. A driver may own one reader thread, which fills a queue and
    does nothing else. The loop calls `read` and `poll` at every turn.
    """

    name: str

    def open(self) -> DeviceInfo:
        """Connect, identify, set the device's own limits, move nothing.

        Raises:
            PortError, SilentError, ProtocolError: one line each, with what to do.
        """

    def close(self) -> None:
        """Stop what moves, close the port. Never raises; may be called twice."""

    def apply(self, command: Command) -> Command:
        """Queue a command, within a millisecond; its outcome comes from `poll`, under the command's id.

        Returns:
            The command as it will be sent: too great a speed is clamped.

        Raises:
            CommandError: not for this device, not finite or out of range. Nothing was sent.
        """

    def read(self) -> Sequence[SampleBlock]:
        """Blocks that have arrived since the last call, in order for each stream."""

    def poll(self) -> Sequence[Status]:
        """Statuses since the last call, in order."""

    def account(self) -> Mapping[str, object]:
        """How the link did so far (frames, losses, drift), for the manifest; empty where there is nothing to report."""


@runtime_checkable
class OwnZero(Protocol):
    """A device that does not keep the zero of a `Tare`, as well as being a `Device`: it is the driver's, until it is
    opened again."""

    def zero_setting(self, stream: str) -> str:
        """The line of TOML that has the profile keep a stream's present zero; "" where no setting does."""


class Question(NamedTuple):
    """A question on the console, numbered by its device: two may have the same text."""

    number: int
    text: str


@runtime_checkable
class Asking(Protocol):
    """A device that asks the person at the console, as well as being a `Device`."""

    @property
    def question(self) -> Question | None:
        """What it waits for now."""

    def answer(self, number: int, done: bool) -> None:
        """The person confirms that it is done, or declines; an answer to an older question is ignored."""
