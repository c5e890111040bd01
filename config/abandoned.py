"""A program of its own that creeps with one mover and is then killed, or frozen: what stops the mover is the device."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.core.clock import monotonic_s
from drivers.core.errors import DeviceError

if TYPE_CHECKING:
    from behaviors.events import Event
    from config.profile import Profile
    from controller.by_hand import HandSession
    from controller.certify import Mover
    from drivers.core.messages import Command

BEGIN_S = 120.0
"""Longest time until it creeps: its start, the device's opening and the way to where it begins."""


LOOK_S = 0.02
"""How often it is looked whether somebody has ended the certificate."""


@contextmanager
def abandoned(
    profile: Profile, session: HandSession, stopped: Callable[[], bool], mover: Mover, frozen: bool
) -> Iterator[float]:
    """Let a program begin to creep, and end it; gives where the mover was seen last, in m.

    Args:
        session: The bench that it has meanwhile, and the limits that its guard admits and watches by; closed here.
        stopped: Whether a person has ended the certificate: the program is killed at once.
        frozen: Whether the program and the process of its arm are frozen while this lasts, and not killed.

    Raises:
        EOFError: it ended by itself, before it crept; why, as far as it said.
        TimeoutError: it does not come that far.
        KeyboardInterrupt: somebody has ended the certificate.
    """
    context = get_context("spawn")
    here, there = context.Pipe(duplex=False)
    arguments = (
        profile.name,
        profile.resolved,
        profile.source.folders,
        session.rig.endpoints,
        pickle.dumps((mover, {*session.rig.devices}, session.limits, session.scene)),
        there,
    )
    program = context.Process(target=_creep, args=arguments)
    program.start()
    there.close()
    victims: list[int] = []
    try:
        until_s = monotonic_s() + BEGIN_S
        while not here.poll(LOOK_S):
            if stopped():
                raise KeyboardInterrupt("interrupted")
            if monotonic_s() > until_s:
                raise TimeoutError(f"the program that is to be killed does not creep within {BEGIN_S:g} s")
        place_m = _place_m(here)
        assert program.pid is not None
        victims = [program.pid, *(_children(program.pid) if frozen else ())]
        for pid in reversed(victims):
            os.kill(pid, signal.SIGSTOP if frozen else signal.SIGKILL)
        try:
            while here.poll():  # it went on until now
                place_m = _place_m(here)
        except EOFError as error:
            if error.args:  # it had ended by itself
                raise
        except OSError:  # killed within a word
            pass
        yield place_m
    finally:
        for pid in victims[1:]:
            os.kill(pid, signal.SIGKILL)
        program.kill()
        program.join()
        here.close()


def _place_m(told: Connection) -> float:
    """What the program says next: where its mover is, or why it ended by itself."""
    said = told.recv()
    if isinstance(said, str):
        raise EOFError(said)
    return float(said)


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
    """The program: creep in the loop and under the guard, say where the mover is, and go on until killed."""
    from config.profile import load_resolved
    from config.verbs.by_hand import session_on
    from controller.by_hand import scripted
    from controller.certify import Wrong
    from controller.console import Console

    profile = load_resolved(name, resolved, folders)
    # only now is the class of its settings found, which may stand beside the profile
    mover, devices, limits, scene = pickle.loads(packed)
    own = profile.for_trial(profile.trials(0)[0])
    session = session_on(own, devices, Console(), endpoints, limits=limits, scene=scene)
    wrong = Wrong()
    creeping = scripted(mover.creeping(wrong, BEGIN_S))

    def steer(event: Event) -> Sequence[Command] | None:
        commands = creeping(event)
        if wrong.begun:
            told.send(float(session.latest.values(mover.shown)[-1, 0]))
        return commands

    try:
        with session:
            told.send(session.run(steer, mover.name, {mover.shown}, deadline_s=BEGIN_S).reason)
    except DeviceError as error:
        told.send(str(error))
