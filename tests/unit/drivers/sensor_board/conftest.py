"""A sensor board's driver on an emulated board, in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.sensor_board.driver import SensorBoard, SensorBoardSettings
from simulator.devices.sensor_board import EmulatedSensorBoard, EmulatedSensorBoardSettings
from tests.unit.drivers.sensor_board.board_bench import Bench, Host, HostClock, Source

BEGIN_S = 5000.0
"""Monotonic time at which the bench begins: the host has been up for a while."""


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    """`make_bench(board={…}, driver={…})`: both with their defaults but for these settings; not yet open."""

    def made(board: dict[str, Any] | None = None, driver: dict[str, Any] | None = None) -> Bench:
        source = Source(BEGIN_S)
        emulated = EmulatedSensorBoard(EmulatedSensorBoardSettings(**(board or {})), source)
        host = Host(emulated, BEGIN_S)
        clock = HostClock(host)
        settings = SensorBoardSettings(port="/dev/board", **(driver or {}))
        return Bench(source, emulated, host, clock, SensorBoard("board", settings, clock, host.connect))

    return made


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    """An open board."""
    made = make_bench()
    made.driver.open()
    return made
