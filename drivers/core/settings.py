"""The base of every settings class: frozen, strict, finite, and closed to unknown keys."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict

os.environ.setdefault(
    "PYDANTIC_DISABLE_PLUGINS", "__all__"
)  # to look for some reads what each package says of itself


@dataclass(frozen=True, slots=True)
class Mark:
    """What a setting is, whatever its key: the name of something else in the profile, which must be there, or what
    others know it by."""

    what: Literal[
        "device", "stream", "detector", "address", "baseline", "drive", "home_speed", "limit", "silences"
    ]


DeviceName = Annotated[str, Mark("device")]
"""A device, by its name in the profile."""

StreamName = Annotated[str, Mark("stream")]
"""A stream, as `device.stream` or `signals.name`."""

DetectorName = Annotated[str, Mark("detector")]
"""A detector, by its name in the profile."""

Address = Annotated[str, Mark("address")]
"""Where a device is reached over a network: a profile writes it as the device's `port`."""

BaselineS = Annotated[float, Mark("baseline")]
"""Time for which a detector learns, s: `replay --baseline T0:T1` sets it."""

DriveHz = Annotated[float, Mark("drive")]
"""Frequency with which transducers are driven: who drives and who listens have the same one."""

HomeSpeed = Annotated[float, Mark("home_speed")]
"""Speed of a device's `Home`, m/s: no command carries it, so no guard can see it."""

LIMIT = Mark("limit")
"""A largest value that the lab has to know: where it is asked for and not given, nothing is held against another's."""

SILENCES = Mark("silences")
"""Time without a word from the host after which a device falls silent, and moves nothing: it may be tried at rest."""


class Mismatch(NamedTuple):
    """A setting that does not go with others: path of its table in the profile, key, and ` = value: what to do`."""

    path: tuple[str, ...]
    key: str
    mistake: str


class Settings(BaseModel):
    """Validated settings; each subclass sits beside the class that it configures.

    Numbers are finite, integers are accepted where a float is asked for, nothing else is converted,
    and an unknown key is an error. The text below a field says what it is, its unit and its source.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, validate_default=True, defer_build=True
    )

    def mismatches(
        self, path: tuple[str, ...], profile: Mapping[tuple[str, ...], Settings]
    ) -> Iterable[Mismatch]:
        """What does not go with the rest of the profile; a class that has such rules overrides it.

        Args:
            path: Where these settings stand: `("detectors", "contact")`.
            profile: All settings that are sound by themselves, by their path.
        """
        return ()

    @property
    def serial_port(self) -> bool:
        """Whether the `port` of this device is a serial one, which one device alone can have."""
        return False

    @classmethod
    @cache
    def keys_of(cls, what: str) -> tuple[str, ...]:
        """The settings that mean something: see `Mark`."""
        return tuple(key for key, field in cls.model_fields.items() if Mark(what) in field.metadata)  # type: ignore[arg-type]
