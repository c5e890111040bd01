"""What can go wrong with a device. Each error is also the standard one that fits it."""

import sys
from collections.abc import Iterable
from pathlib import Path

PROGRAM = "run.py" if Path(__file__).parents[2].joinpath("pyproject.toml").is_file() else "touchbench"
"""How a person calls this program: in a clone by its file, installed by its command."""


class DeviceError(Exception):
    """A device cannot do its part.

    Args:
        doing: What was going on ("opening", "moving to 0.012 m").
    """

    def __init__(self, device: str, doing: str, reason: str, advice: str) -> None:
        self.device = device
        self.doing = doing
        self.reason = reason
        self.advice = advice
        super().__init__(f"{device}: {reason} while {doing}; {advice}")


class PortError(DeviceError, OSError):
    """The port is absent, busy or was taken away."""


class SilentError(DeviceError, TimeoutError):
    """The device does not answer."""


class ProtocolError(DeviceError, ValueError):
    """What arrived is not this device's protocol."""


class RefusedError(DeviceError, RuntimeError):
    """The device, or its driver, will not do what was asked."""


class CommandError(DeviceError, ValueError):
    """The command makes no sense for this device: not finite, out of range, of another kind."""


class CodecError(ValueError):
    """Bytes or a line outside a device's protocol, or a message that it cannot encode."""


def wrong(device: str, command: object, reason: str, advice: str) -> CommandError:
    """The error of a command that a device cannot take."""
    return CommandError(device, f"applying {type(command).__name__}", reason, advice)


def first_line(error: Exception) -> str:
    """What another library's error says in its first line; its class where it says nothing."""
    said = next((each for each in error.args if isinstance(each, str)), str(error))
    return next(iter(said.splitlines()), type(error).__name__)


WHEELS_TO = {"ur": (3, 12)}
"""Extras whose library has no wheel for later Pythons (pyproject.toml leaves it out there)."""


def lacking(library: str, extra: str) -> tuple[str, str]:
    """Reason and advice where a library is missing that is installed on demand.

    Args:
        extra: Of touchbench, which brings it; "" where none does.
    """
    brings = f"'touchbench[{extra}]'" if extra else library
    if sys.version_info[:2] > (last := WHEELS_TO.get(extra, sys.version_info[:2])):
        return f"{library} has no wheel for this Python", f"use Python {last[0]}.{last[1]}"
    return f"{library} is not installed", f"install it: pip install {brings}"


def check_streams(device: str, command: object, streams: Iterable[str], known: Iterable[str]) -> None:
    """Check that a command names only the device's own streams.

    Raises:
        CommandError: it names another.
    """
    has = sorted(known)
    for stream in sorted(set(streams).difference(has)):
        advice = f"it has: {', '.join(has) or 'none before it is open'}"
        raise wrong(device, command, f"it has no stream {stream}", advice)
