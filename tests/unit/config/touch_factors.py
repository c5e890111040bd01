"""Factors of the small table's experiment: texts of settings are read from a module that is found by its name."""

from pydantic import Field

from drivers.settings import Settings


class TouchFactors(Settings):
    speed_m_s: float = Field(gt=0.0, le=0.05)
    """Speed of the approach. On the mover's axis."""

    location: str = "f"
