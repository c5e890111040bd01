"""The base of every settings class: frozen, strict, finite, and closed to unknown keys."""

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict


@dataclass(frozen=True, slots=True)
class Refers:
    """Marks a setting that names something else in the profile, which must be there."""

    to: Literal["device", "stream", "detector"]


DeviceName = Annotated[str, Refers("device")]
"""A device, by its name in the profile."""

StreamName = Annotated[str, Refers("stream")]
"""A stream, as `device.stream` or `signals.name`."""

DetectorName = Annotated[str, Refers("detector")]
"""A detector, by its name in the profile."""


class Settings(BaseModel):
    """Validated settings; each subclass sits beside the class that it configures.

    Numbers are finite, integers are accepted where a float is asked for, nothing else is converted,
    and an unknown key is an error. The text below a field says what it is, its unit and its source.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        validate_default=True,
    )
