"""Stages that are known by their device id: what the protocol does not tell, the length of a microstep."""

import tomllib
from functools import cache
from pathlib import Path
from typing import NamedTuple

AS_DELIVERED = 64
"""Microsteps a step for which the table holds (`resolution` in the device)."""


class StageModel(NamedTuple):
    """A series and screw, as in "X-LSM-A", and its microstep as delivered."""

    name: str
    microstep_m: float


def stage_model(device_id: str | int) -> StageModel | None:
    """The model of an id; None where the id is not in the table, or is no number."""
    return _models().get(str(device_id))


@cache
def _models() -> dict[str, StageModel]:
    table = tomllib.loads((Path(__file__).parent / "models.toml").read_text(encoding="utf-8"))
    return {
        str(number): StageModel(name, row["microstep_m"])
        for name, row in table.items()
        for first, last in row["ids"]
        for number in range(first, last + 1)
    }
