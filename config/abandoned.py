"""A program of its own that creeps with one mover and is then killed, or frozen: what stops the mover is the device."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from config.profile import Profile
    from controller.certify import Mover
    from drivers.core.protocols import Device

BEGIN_S = 120.0
"""Longest time until it creeps: its start, the device's opening and the way to where it begins."""


@contextmanager
def abandoned(
    profile: Profile, endpoints: Mapping[str, Any] | None, mover: Mover, frozen: bool
) -> Iterator[float]:
    """Let a program begin to creep, and end it; gives where the mover was seen last, in m.

    Args:
        endpoints: Of the emulator that serves the bench; None on a real one.
        frozen: Whether the program and the process of its arm are frozen while this lasts, and not killed.

    Raises:
        EOFError: it ended by itself, before it crept.
        TimeoutError: it does not come that far.
    """
    context = get_context("spawn")
    here, there = context.Pipe(duplex=False)
    arguments = (
        profile.name,
        profile.resolved,
        profile.source.folders,
        endpoints,
        pickle.dumps(mover),
        there,
    )
    program = context.Process(target=_creep, args=arguments)
    program.start()
    there.close()
    victims: list[int] = []
    try:
        if not here.poll(BEGIN_S):
            raise TimeoutError(f"the program that is to be killed does not creep within {BEGIN_S:g} s")
        place_m = here.recv()
        assert program.pid is not None
        victims = [program.pid, *(_children(program.pid) if frozen else ())]
        for pid in reversed(victims):
            os.kill(pid, signal.SIGSTOP if frozen else signal.SIGKILL)
        yield place_m
    finally:
        for pid in victims[1:]:
            os.kill(pid, signal.SIGKILL)
        program.kill()
        program.join()
        here.close()


def _children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def _creep(
    name: str,
    resolved: Mapping[str, Any],
    folders: Sequence[Path],
    endpoints: Mapping[str, Any] | None,
    packed: bytes,
    told: Connection,
) -> None:
    """The program: creep, say where the mover is, and go on until killed."""
    from config.assemble import build_rig
    from config.profile import load_resolved
    from controller.certify import RUN_S
    from drivers.core.messages import Listen, Reached

    profile = load_resolved(name, resolved, folders)
    # only now is the class of its settings found, which may stand beside the profile
    mover: Mover = pickle.loads(packed)
    rig = build_rig(profile, endpoints, devices={mover.name})
    device: Device = rig.devices[mover.name]
    device.open()
    rig.clock.restart()
    device.apply(Listen(mover.name, frozenset({mover.shown})))
    commands, place_m, creeps_s = [mover.drive, mover.start, mover.ready], 0.0, float("inf")
    device.apply(commands.pop())
    while True:
        rig.clock.rest(0.005)
        for block in device.read():
            place_m = float(block.physical[-1, 0])
        for status in device.poll():
            if isinstance(status, Reached) and commands:
                device.apply(commands.pop())
                creeps_s = rig.clock.now() if not commands else creeps_s
        if rig.clock.now() - creeps_s > RUN_S:
            creeps_s = float("inf")
            told.send(place_m)
