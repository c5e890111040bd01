"""Every limit of the shipped benches acts on the wire too: real drivers, devices of their own, watchdogs that trip."""

from __future__ import annotations

import time

import pytest

from config.certificate import certifier_of
from config.profile import load_profile

BENCHES = {
    "emulated/transient": {
        "limits.blind_travel_m",
        "devices.board.watchdog_s",
        "devices.stage.max_speed_m_s",
    },
    "emulated/first_contact": {"limits.force_n", "devices.board.watchdog_s"},
    "emulated/pretouch": {
        "devices.arm.loop_timeout_s",
        "devices.arm.watchdog_hz",
        "devices.gripper.watchdog_s",
        "limits.grip_n",
    },
    "emulated/slip": {"devices.arm.leash_m", "devices.board.watchdog_s", "limits.reach_rad"},
    "emulated/weights": {"limits.stuck_s", "devices.board.watchdog_s"},
}
"""One profile of each set of devices, and some of what it must have shown."""


@pytest.mark.parametrize("name", BENCHES)
def test_every_limit_of_an_emulated_bench_acts(name):
    proofs = list(certifier_of(load_profile(name)).proofs())
    assert [proof for proof in proofs if proof.verdict not in ("acted", "nothing to bound")] == []
    assert {proof.limit for proof in proofs} >= BENCHES[name]
    killed = [proof for proof in proofs if "its program is killed" in proof.done]
    assert len(killed) == (name != "emulated/weights")
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
