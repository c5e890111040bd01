"""Stops, limits and watchdogs of the shipped benches act on the wire too: real drivers, devices of their own.

What loop and guard do by a limit is shown on every mock bench (tests/scenarios/test_certify.py), and on one of these
again: an emulated or a hardware profile has its mock twin's limits, but for those that the lab gives. What remains are
the devices, each of which is some bench's with the same settings and the same bounds: what these and their processes do
by themselves is shown here.
"""

import json
import time

import pytest

from config.assemble import limits_of
from config.certificate import certifier_of
from config.profile import load_profile
from config.source import profile_names, read_source
from controller.certify import Certifier

BETWEEN = ("_streams", "_forces", "_travel", "_asked", "_of_device")
"""Cases of what goes wrong, or is refused, above the devices."""

ARM = {"limits.blind_travel_m", "devices.arm.loop_timeout_s", "devices.arm.watchdog_hz"}

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
    "emulated/locating": ((*BETWEEN, "_watchdogs"), {"stop of stage", "limits.blind_travel_m"}),
    "emulated/grasp": (
        BETWEEN,
        {"stop of gripper", "devices.gripper.watchdog_s", "devices.board.watchdog_s", *ARM},
    ),
    "emulated/slip": ((*BETWEEN, "_watchdogs"), ARM),
    "emulated/pointer": ((*BETWEEN, "_watchdogs"), ARM),
    "emulated/transient_arm": ((*BETWEEN, "_watchdogs"), ARM),
    "emulated/weights": ((), {"limits.stuck_s", "devices.board.watchdog_s"}),
}
"""Benches that have every device of every emulated bench between them: the cases that are left out, and some of what
each must have shown."""

BOUNDS = ("travel_m", "travel_min_m", "blind_travel_m", "speed_m_s", "reach_m", "reach_rad")


def devices_of(name):
    """Each device of a profile with its settings and the bounds that it may move in."""
    profile = load_profile(name)
    limits = limits_of(profile)
    for device, entry in profile.devices.items():
        bounds = limits.movers.get(device, limits).model_dump(include=set(BOUNDS))
        moves = hasattr(entry.settings, "max_speed_m_s")
        settings = entry.settings.model_dump(mode="json")
        yield json.dumps(
            [entry.kind, settings, bounds if moves else {}, profile.loop.model_dump()], sort_keys=True
        )


def profiles(bench):
    names = [name for name in profile_names() if name.startswith(f"{bench}/")]
    return [name for name in names if "experiment" in read_source(name).data]


def test_each_device_of_each_emulated_bench_is_one_of_these():
    shown = {device for name in BENCHES for device in devices_of(name)}
    assert len(profiles("emulated")) > 15
    for name in profiles("emulated"):
        assert set(devices_of(name)) <= shown, name


@pytest.mark.parametrize("bench", ["emulated", "hardware"])
def test_the_limits_of_each_profile_are_those_of_a_mock_bench_but_for_what_the_lab_gives(bench):
    assert len(profiles(bench)) > 15
    for name in profiles(bench):
        profile, twin = load_profile(name), load_profile(name.replace(bench, "mock"))
        given = {path[1] for path in profile.source.unset if path[0] == "limits"}
        assert given <= {"force_n", "travel_m", "grip_n"}
        assert profile.devices.keys() == twin.devices.keys()
        assert profile.limits.model_dump(exclude=given) == twin.limits.model_dump(exclude=given), name


@pytest.mark.parametrize("name", BENCHES)
def test_every_limit_of_an_emulated_bench_acts(name, monkeypatch):
    left_out, shown = BENCHES[name]
    for cases in left_out:
        monkeypatch.setattr(Certifier, cases, lambda *_: ())
    proofs = list(certifier_of(load_profile(name)).proofs())
    assert [proof for proof in proofs if proof.verdict not in ("acted", "nothing to bound")] == []
    assert {proof.limit for proof in proofs} >= shown
    killed = [proof for proof in proofs if "its program is killed" in proof.done]
    assert len(killed) == (name not in ("emulated/first_contact", "emulated/weights"))
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
