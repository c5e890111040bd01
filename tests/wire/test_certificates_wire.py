"""Stops, limits and watchdogs of the shipped benches act on the wire too: real drivers, devices of their own.

That loop and guard notice each wrong sample, and that drivers refuse what is beyond them, is shown on every mock bench
(tests/scenarios/test_certify.py), and on one of these again; on the others what devices and processes do by themselves.
"""

import time

import pytest

from config.certificate import certifier_of
from config.profile import load_profile
from controller.certify import Certifier

BETWEEN = ("_streams", "_forces", "_travel", "_asked", "_of_device")
"""Cases of what goes wrong, or is refused, above the devices."""

BENCHES = {
    "emulated/transient": (
        (),
        {
            "limits.blind_travel_m",
            "limits.stale_s",
            "devices.board.watchdog_s",
            "devices.stage.max_speed_m_s",
        },
    ),
    "emulated/first_contact": (
        (*(name for name in BETWEEN if name != "_forces"), "_alone", "_watchdogs", "_ended"),
        {"stop of stage", "limits.force_n"},
    ),
    "emulated/pretouch": (
        BETWEEN,
        {
            "stop of gripper",
            "limits.blind_travel_m",
            "devices.arm.loop_timeout_s",
            "devices.arm.watchdog_hz",
            "devices.gripper.watchdog_s",
        },
    ),
    "emulated/weights": ((), {"limits.stuck_s", "devices.board.watchdog_s"}),
}
"""A profile of each kind of mover and of none: the cases that are left out, and some of what it must have shown."""


@pytest.mark.parametrize("name", BENCHES)
def test_every_limit_of_an_emulated_bench_acts(name, monkeypatch):
    left_out, shown = BENCHES[name]
    for cases in left_out:
        monkeypatch.setattr(Certifier, cases, lambda *_: ())
    proofs = list(certifier_of(load_profile(name)).proofs())
    assert [proof for proof in proofs if proof.verdict not in ("acted", "nothing to bound")] == []
    assert {proof.limit for proof in proofs} >= shown
    killed = [proof for proof in proofs if "its program is killed" in proof.done]
    assert len(killed) == (name in ("emulated/transient", "emulated/pretouch"))
    assert all(proof.way_m is not None and proof.way_m < 2.2e-3 for proof in killed)


class LeftError(Exception):
    """The person has seen enough."""


def test_a_person_may_take_longer_than_a_watchdog_waits():
    profile, answers_s, proofs = load_profile("emulated/pretouch"), [], []

    def consent(text):
        if len(answers_s) == 4:
            raise LeftError
        answers_s.append(time.monotonic() + 1.5)  # real time: gripper and board wait for a second
        return lambda: time.monotonic() > answers_s[-1]

    with pytest.raises(LeftError):
        for proof in certifier_of(profile, consent).proofs():
            proofs.append(proof)
    assert [(proof.limit, proof.verdict) for proof in proofs] == [
        (f"{what} of {mover}", "acted")
        for what, mover in (("home", "arm"), ("stop", "arm"), ("pause", "arm"), ("home", "gripper"))
    ]
