"""What the controller takes the tool for: read at opening, held against the profile, recorded. Pure."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from drivers.arm.axis import way
from drivers.arm.settings import Pose, Vector
from drivers.ur_arm.settings import UrArmSettings

SAME_M, SAME_RAD = 1e-4, 1e-3
"""How far two TCPs may be apart and count as one (assumption: what is rounded at the pendant, in mm and rad)."""

SAME_KG, SAME_COG_M = 0.01, 1e-3
"""The same for payloads, and their centres of gravity (assumption: 0.1 N, the pendant's last digit)."""

PENDANT = 'correct the profile, or Installation > TCP and Payload at the pendant, or write tool = "set"'


class Tool(NamedTuple):
    """The tool that the controller counts with.

    Attributes:
        tcp_offset: The tool's point in the flange's frame: m and rotation vector.
        payload_kg: Mass.
        payload_cog_m: Centre of gravity in the flange's frame.
    """

    tcp_offset: Pose
    payload_kg: float
    payload_cog_m: Vector

    def details(self, settings: UrArmSettings) -> Mapping[str, object]:
        """For the manifest: the tool, and what of it the profile does not state."""
        missing = tuple(name for name in self._fields if getattr(settings, name) is None)
        return {**self._asdict(), "not_stated_by_the_profile": missing}


NO_TOOL = Tool((0.0,) * 6, 0.0, (0.0,) * 3)
"""What a controller counts with where nobody has entered a tool."""


def stated(settings: UrArmSettings, otherwise: Tool = NO_TOOL) -> Tool:
    """The profile's tool, with what it does not state from another one."""
    given = {name: getattr(settings, name) for name in Tool._fields}
    return otherwise._replace(**{name: value for name, value in given.items() if value is not None})


def disagreement(settings: UrArmSettings, found: Tool) -> str:
    """In what the controller's tool is not the profile's, or ""; what the profile does not state is not compared."""
    length_m, angle_rad = way(settings.tcp_offset or found.tcp_offset, found.tcp_offset)
    payload_kg = found.payload_kg if settings.payload_kg is None else settings.payload_kg
    cog_m = settings.payload_cog_m or found.payload_cog_m
    same = {
        "tcp_offset": length_m <= SAME_M and angle_rad <= SAME_RAD,
        "payload_kg": abs(payload_kg - found.payload_kg) <= SAME_KG,
        "payload_cog_m": math.dist(cog_m, found.payload_cog_m) <= SAME_COG_M,
    }
    return ", ".join(
        f"its {name} is {_shown(getattr(found, name))}, the profile's {_shown(getattr(settings, name))}"
        for name, agrees in same.items()
        if not agrees
    )


def _shown(value: float | tuple[float, ...]) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(f'{part:.6g}' for part in value)}]"
    return f"{value:.6g}"
