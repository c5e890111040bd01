"""What a real room adds to what a finger receives; `RoomSettings` sets how much."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.physics.aura_kernel import Air
from simulator.physics.aura_settings import RoomSettings

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

ROOM_PHASES = 16
"""Phases that a finger draws for a trial: of the second path, two each of ripple and vibration, then of the echoes."""

MOVING_M_S = 0.002
"""Speed from which on a vibration is there in full. Assumption."""


def second_path(room: RoomSettings, gap_m: Floats, wave_rad_m: Floats, turned_rad: float) -> Complexes:
    """Factor by which sound that comes back by way of a surface beside the fingers changes an echo, shape (n,)."""
    near_m = np.where(np.isfinite(gap_m), np.maximum(gap_m, 0.0), 1.0)
    longer_m = np.hypot(near_m, 2.0 * room.second_path_m) - near_m
    found: Complexes = 1.0 + room.second_path * np.exp(1j * (turned_rad - wave_rad_m * longer_m))
    return found


def room_field(
    room: RoomSettings,
    air: Air,
    x_m: Floats,
    speed_m_s: Floats,
    times_s: Floats,
    wave_rad_m: Floats,
    phases_rad: Floats,
) -> Complexes:
    """What the room adds to a finger's bridge, shares of full scale at full drive, shape (n,).

    Args:
        x_m: Way of the tool since the start pose, shape (n,).
        speed_m_s: Of the mechanism, shape (n,).
        times_s: Shape (n,).
        wave_rad_m: Wave number, shape (n,).
        phases_rad: Drawn for this finger and trial, shape (ROOM_PHASES,).
    """
    found = np.zeros(len(x_m), dtype=np.complex128)
    for echo, turned_rad in zip(room.echoes, phases_rad[5:], strict=False):
        to_and_fro_m = echo.stroke_m * np.sin(2.0 * np.pi * echo.stroke_hz * times_s + turned_rad)
        way_m = np.maximum(echo.away_m - echo.cosine * x_m + to_and_fro_m, 0.0)
        nearer = ((air.decay_m + echo.away_m) / (air.decay_m + way_m)) ** air.decay_power
        found += echo.size_fs * nearer * np.exp(1j * (turned_rad - 2.0 * wave_rad_m * way_m))
    teeth = np.cos(2.0 * np.pi * x_m / room.ripple_m + phases_rad[1])
    found += room.ripple_fs * np.exp(1j * phases_rad[2]) * teeth
    shaken = np.minimum(speed_m_s / MOVING_M_S, 1.0) * np.cos(
        2.0 * np.pi * room.vibration_hz * times_s + phases_rad[3]
    )
    found += room.vibration_fs * np.exp(1j * phases_rad[4]) * shaken
    return found
