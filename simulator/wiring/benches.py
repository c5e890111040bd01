"""The benches that profiles name: which parts each is made of."""

from __future__ import annotations

from simulator.physics.aura_part import AuraPart
from simulator.physics.bench import Bench
from simulator.physics.finger_part import FingerBenchSettings, FingerPart
from simulator.physics.fingertip_part import FingertipPart
from simulator.physics.fingertip_settings import SlipBenchSettings
from simulator.physics.gripper_part import AuraBenchSettings, GripperPart
from simulator.physics.pad_part import GraspBenchSettings, PadPart


def finger(settings: FingerBenchSettings) -> Bench:
    """A probe and the resonant finger that it meets."""
    bench = Bench(settings, "probe")
    FingerPart(bench, settings)
    return bench


def slip(settings: SlipBenchSettings) -> Bench:
    """A tip with one of five force sensors, on a table."""
    bench = Bench(settings, "tip", one_axis="this mover cannot slide and roll")
    FingertipPart(bench, settings)
    return bench


def aura(settings: AuraBenchSettings) -> Bench:
    """A gripper with two sonic fingers, an object between them or before one of them."""
    bench = Bench(settings, "gripper", one_axis="this mover moves along one axis alone")
    AuraPart(bench, GripperPart(bench, settings), settings)
    return bench


def grasp(settings: GraspBenchSettings) -> Bench:
    """A gripper with two sonic fingers, one of which has a force sensor in its pad, and an object on a table."""
    bench = Bench(settings, "gripper", one_axis="this mover moves along one axis alone")
    gripper = GripperPart(bench, settings)
    AuraPart(bench, gripper, settings)
    PadPart(bench, gripper, settings)
    return bench
