"""A sensor board's driver on an emulated board, in virtual time."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.unit.drivers.sensor_board.board_bench import Bench


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    """`make_bench(board={…}, driver={…})`: both with their defaults but for these settings; not yet open."""

    def made(board: dict[str, Any] | None = None, driver: dict[str, Any] | None = None) -> Bench:
        return Bench(board or {}, driver or {})

    return made


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    """An open board."""
    made = make_bench()
    made.device.open()
    return made
