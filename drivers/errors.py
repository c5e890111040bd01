"""What can go wrong with a device. Each error is also the standard one that fits it."""

from __future__ import annotations


class DeviceError(Exception):
    """A device cannot do its part.

    Args:
        device: Name in the profile.
        doing: What was going on ("opening", "moving to 0.012 m").
        reason: What happened.
        advice: What to do about it.
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
    """What came is not what this device says."""


class RefusedError(DeviceError, RuntimeError):
    """The device, or its driver, will not do what was asked."""


class CommandError(DeviceError, ValueError):
    """The command makes no sense for this device: not finite, out of range, of another kind."""
