"""Two fingers about an object: the bench's plant and arm, without loop, drivers and recorder."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.can_gripper.units import STROKE_M
from drivers.messages import SampleBlock
from drivers.mock.physics.aura import BOTH, ENVELOPE_HZ, LEFT, RIGHT, AuraMotion, AuraPlant
from drivers.mock.physics.aura_jaws import jaws_settings
from drivers.mock.physics.aura_objects import OBJECTS
from drivers.mock.physics.aura_settings import RoomSettings
from drivers.mock.physics.gripper_part import AuraBenchSettings
from drivers.mock.physics.tool_motion import ToolMotion
from drivers.ur_arm.stream import RATE_HZ as ENCODER_HZ

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

DRIVE_HZ, LEVEL = 40_000.0, 0.5
"""As behaviors/centering.py drives it."""

ACCELERATION_M_S2, STOP_M_S2, MAX_SPEED_M_S = 0.5, 3.0, 0.06
"""The arm's, as in the profile mock/bench_aura."""

STILL_S = 0.02
"""Delay after which the arm reports standstill."""

TOUCH_M = 1e-9
"""Nearer than this is touching."""

TURNED = 500_000
"""Added to a search's number, keys the noise after a turn."""

CLOCK_EDGE = 1e-7
"""Tolerance of a time to a turn, as a share of it."""


class Place(NamedTuple):
    """One search to be made.

    Attributes:
        seed, number: Key of all noise.
        object: What stands between the fingers.
        object_x_m: Where its middle is, from the gripper's at the start.
        speed_m_s: Of the search.
        mismatch_db: By how much the right finger is more sensitive than the left.
        begin_s: When the rest before the search begins, on the bench's clock.
        finger_db: Standard deviation of each finger's sensitivity from search to search.
        room: The room.
        fades: Sensitivity of the right finger after half a turn, as a share of the one before.
        decays: Distance over which the sound of the right finger spreads, as a share of the left one's.
    """

    seed: int
    number: int
    object: str
    object_x_m: float
    speed_m_s: float
    mismatch_db: float = 0.0
    begin_s: float = 8.92
    finger_db: float = 0.0
    room: RoomSettings = RoomSettings()
    fades: float = 1.0
    decays: float = 1.0


class CenteringScene:
    """The fingers' signals while the arm moves to and fro; the object slides where a finger pushes it.

    Args:
        place: The search.

    Attributes:
        arm: The tool's motion.
        object_x_m: Current position of the object's middle.
        touches: How often a finger began to touch it.
    """

    def __init__(self, place: Place) -> None:
        settings = AuraBenchSettings(
            object=place.object,
            mismatch_db=place.mismatch_db,
            finger_scatter_db=place.finger_db,
            room=place.room,
        )
        thing = OBJECTS[place.object]
        self.arm = ToolMotion(
            (1.0, 0.0, 0.0), acceleration_m_s2=ACCELERATION_M_S2, max_speed_m_s=MAX_SPEED_M_S
        )
        self.arm.place(0.0, 0.0)
        self.object_x_m = place.object_x_m
        self.touches = 0
        self._plant = AuraPlant(settings)
        # the right finger has a plant of its own where its sound spreads differently
        other = settings.model_copy(update={"decay_m": place.decays * settings.decay_m})
        self._right = self._plant if place.decays == 1.0 else AuraPlant(other)
        self._place, self._thing, self._top_m = place, thing, settings.object_top_m
        for plant in {self._plant, self._right}:
            plant.begin((place.seed, place.number), thing, self._top_m, "normal")
        self._push_n = settings.push_n
        jaws = jaws_settings(settings.closed_width_m)
        self._width_m = jaws.closed_width_m + STROKE_M
        self._half_m = 0.5 * (self._width_m - thing.width_m)
        self._touching = np.zeros(2, bool)
        self.turned = False

    def turn(self) -> None:
        """Turn the gripper half around its own axis: each finger is where the other was, as sensitive as it was.

        The room's echoes are redrawn for each: their phases belong to places."""
        self.turned = not self.turned
        key = (self._place.seed, TURNED + self._place.number)
        for plant in {self._plant, self._right}:
            (right, left), reflected = plant._gains, plant._reflected
            plant.begin(key, self._thing, self._top_m, "normal")
            plant.__dict__.update(_gains=(right * self._place.fades, left), _reflected=reflected)

    def receive(self, first: int, end: int) -> tuple[NDArray[np.complex128], SampleBlock]:
        """Envelope of both fingers in milliseconds `first` to `end` - 1, shape (n, 2), and the arm's encoder.

        The arm's motion until then must be known; each span is received once.
        """
        ticks = np.arange(first, end, dtype=np.int64)
        motion = self._pushed(ticks)
        n = len(ticks)
        inputs = motion, ticks, ticks / ENVELOPE_HZ, np.full(n, DRIVE_HZ), np.full(n, LEVEL), BOTH
        z = self._plant.envelope(*inputs)
        if self._right is not self._plant:
            z[:, RIGHT] = self._right.envelope(*inputs)[:, RIGHT]
        step = round(ENVELOPE_HZ / ENCODER_HZ)
        readings = np.arange(-(-first // step), -(-end // step), dtype=np.int64)
        position = self.arm.coordinates(readings / ENCODER_HZ)[:, :1]
        encoder = SampleBlock(
            "arm.position",
            int(readings[0]) if len(readings) else 0,
            float(readings[0] / ENCODER_HZ) if len(readings) else 0.0,
            position,
            rate_hz=ENCODER_HZ,
            unit="m",
        )
        return z, encoder

    def foresee(self, first: int, end: int) -> tuple[NDArray[np.complex128], SampleBlock, bool]:
        """The same for a predicted span that may still change, and whether it is free of touches."""
        kept = self.object_x_m, self.touches, self._touching.copy()
        z, encoder = self.receive(first, end)
        clear = self.touches == kept[1] and not kept[2].any() and self.object_x_m == kept[0]
        self.object_x_m, self.touches, self._touching = kept
        return z, encoder, clear

    def _pushed(self, ticks: Ints) -> AuraMotion:
        times_s = ticks / ENVELOPE_HZ
        before_s = float(times_s[0]) - 1.0 / ENVELOPE_HZ
        tools_m = self.arm.coordinates(np.concatenate(([before_s], times_s)))[:, 0]
        tool_m = tools_m[1:]
        # the left finger pushes forward, the right one backward; never both between two places of a search
        forward = np.maximum(np.maximum.accumulate(tool_m) - self._half_m, self.object_x_m)
        object_m = np.minimum(np.minimum.accumulate(tool_m) + self._half_m, forward)
        gap_m = np.empty((len(ticks), 2))
        gap_m[:, RIGHT] = self._half_m - (object_m - tool_m)
        gap_m[:, LEFT] = self._half_m + (object_m - tool_m)
        touching = gap_m <= TOUCH_M
        begun = touching & ~np.vstack((self._touching, touching[:-1]))
        self.touches += int(begun.sum())
        self._touching = touching[-1]
        self.object_x_m = float(object_m[-1])
        n = len(ticks)
        if self.turned:
            gap_m, touching = gap_m[:, ::-1], touching[:, ::-1]
        return AuraMotion(
            gap_m,
            np.zeros(n),
            np.zeros(n),
            np.full(n, self._width_m),
            np.asarray(self._push_n * touching, np.float64),
            ENVELOPE_HZ * np.abs(np.diff(tools_m)),
            tool_m,
        )

    def gap_m(self, finger: int, tool_m: float) -> float:
        """From a finger to the object where it stands now, with the tool at a place."""
        sign = 1.0 if (finger == LEFT) != self.turned else -1.0
        return self._half_m + sign * (self.object_x_m - tool_m)


def turn_at(t_s: float, loop_hz: float) -> float:
    """The loop's first turn at `t_s` or after: when a command can be given."""
    return math.ceil(t_s * loop_hz - CLOCK_EDGE) / loop_hz


def after(t_s: float) -> int:
    """Number of the first millisecond after `t_s`."""
    return math.floor(t_s * ENVELOPE_HZ + 1e-6) + 1
