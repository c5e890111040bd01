"""Emulated devices on the bench that they share, as an emulator makes them: settings and bench in, device out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivers.mock.devices.sensor_board import EmulatedSensorBoard, EmulatedSensorBoardSettings
from drivers.mock.devices.zaber_stage import EmulatedZaberStage, EmulatedZaberStageSettings
from drivers.mock.finger_bench import FingerBench


def zaber_stage(settings: Mapping[str, Any], bench: FingerBench) -> EmulatedZaberStage:
    """The stage that carries the bench's probe."""
    return EmulatedZaberStage(EmulatedZaberStageSettings.model_validate(settings), bench.axis, bench.on_plan)


def sensor_board(settings: Mapping[str, Any], bench: FingerBench) -> EmulatedSensorBoard:
    """The board that is wired to the bench's sensors and drive."""
    return EmulatedSensorBoard(EmulatedSensorBoardSettings.model_validate(settings), bench)
