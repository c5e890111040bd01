"""What every device is, and what some are besides."""

from typing import NamedTuple, Protocol, runtime_checkable

from drivers.core.wire import Driver

Device = Driver
"""Mock, emulated or real."""


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
