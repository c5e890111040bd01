"""Stops, limits and watchdogs of the shipped benches act on the wire too: real drivers, devices of their own.

What loop and guard do by a limit is shown on every mock bench (tests/scenarios/test_certify.py): an emulated or a
hardware profile has its mock twin's limits, but for those that the lab gives. What remains is what movers and
watchdogs, and their processes, do by themselves: that depends on neither the place nor the speed at which a profile
has them move, which loop and driver refuse; and of the guard, silence and what presses.
"""

import json
import time

import pytest

from config.profile import load_profile
from config.verbs.certify import certifier_of
from controller.certify import Certifier
from tests.scenarios.test_certify import profiles

BETWEEN = ("_streams", "_forces", "_travel", "_asked", "_of_device")
"""Cases of what goes wrong, or is refused, above the devices."""

BENCHES = {
    "emulated/transient": (
        ("_forces", "_travel", "_asked"),
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
    "emulated/transient_arm": (
        (*BETWEEN, "_watchdogs"),
        {"limits.blind_travel_m", "devices.arm.loop_timeout_s", "devices.arm.watchdog_hz"},
    ),
    "emulated/pretouch": (
        (*BETWEEN, "_alone", "_ended"),
        {"stop of gripper", "devices.gripper.watchdog_s"},
    ),
    "emulated/weights": ((), {"limits.stuck_s", "devices.board.watchdog_s"}),
}
"""Benches that have every device of every emulated bench that acts by itself: the cases that are left out, and some of
what each must have shown."""

PLACES = {"start_pose", "approach_axis", "leash_m", "travel_min_m", "travel_max_m"}
SPEEDS = {"max_speed_m_s", "home_speed_m_s"}


def acting(name):
    """Each device of a profile that moves or has a watchdog, with its settings but for places and speeds."""
    profile = load_profile(name)
    blind_m = profile.limits.model_dump()["blind_travel_m"]
    for entry in profile.devices.values():
        settings = entry.settings.model_dump(mode="json")
        if settings.keys() & {*SPEEDS, "watchdog_s"}:
            own = {key: value for key, value in settings.items() if key not in PLACES | SPEEDS}
            yield json.dumps([entry.kind, own, blind_m if settings.keys() & SPEEDS else None], sort_keys=True)


def test_each_device_that_acts_by_itself_on_an_emulated_bench_is_one_of_these():
    shown = {device for name in BENCHES for device in acting(name)}
    assert len(shown) > 3
    assert len(profiles("emulated")) > 15
    for name in profiles("emulated"):
        assert set(acting(name)) <= shown, name


@pytest.mark.parametrize("bench", ["emulated", "hardware"])
def test_the_limits_of_each_profile_are_those_of_a_mock_bench_but_for_what_the_lab_gives(bench):
    assert len(profiles(bench)) > 15
    for name in profiles(bench):
        profile, twin = load_profile(name), load_profile(name.replace(bench, "mock"))
        given = {path[1] for path in profile.source.unset if path[0] == "limits"}
        assert given <= {"force_n", "travel_m", "grip_n"}
        assert profile.devices.keys() == twin.devices.keys()
        assert profile.limits.model_dump(exclude=given) == twin.limits.model_dump(exclude=given), name


OWN_STAGE = """
from drivers.zaber_stage.driver import ZaberStage, ZaberStageSettings
from simulator.devices.zaber_stage import emulated as EmulatedOwnStage


class OwnStageSettings(ZaberStageSettings):
    pass


class OwnStage(ZaberStage):
    pass
"""
"""A stage beside its profile: the program that is killed has to find its class as well."""


def with_own_stage(folder):
    """A profile of `emulated/transient` with that stage."""
    (folder / "lab_of_stages.py").write_text(OWN_STAGE)
    text = 'extends = "emulated/transient"\ndevices.stage = { driver = "lab_of_stages:OwnStage", port = "emulated" }\n'
    (folder / "own.toml").write_text(text)
    return str(folder / "own.toml")


BLIND_M = 0.0005


@pytest.mark.parametrize("name", BENCHES)
def test_every_limit_of_an_emulated_bench_acts(name, monkeypatch, tmp_path):
    left_out, shown = BENCHES[name]
    for cases in left_out:
        monkeypatch.setattr(Certifier, cases, lambda *_: ())
    own = name == "emulated/transient"
    # no faster than a stage may go that is to halt within it
    sets = {"limits.blind_travel_m": f"{BLIND_M}", "limits.speed_m_s": "0.002"} if own else {}
    profile = load_profile(with_own_stage(tmp_path) if own else name, sets)
    proofs = list(certifier_of(profile).proofs())
    assert [proof for proof in proofs if proof.verdict not in ("acted", "nothing to bound")] == []
    assert {proof.limit for proof in proofs} >= shown
    killed = [proof for proof in proofs if "its program is killed" in proof.done]
    assert len(killed) == (name in ("emulated/transient", "emulated/transient_arm"))
    assert all(proof.way_m is not None and proof.way_m < 2.2e-3 for proof in killed)
    if own:
        (proof,) = killed
        assert (proof.value, proof.verdict) == (f"{BLIND_M} m", "acted")
        assert 0.4 * BLIND_M < proof.way_m < 1.4 * BLIND_M, "as its profile says, not as the shipped one does"


def test_the_guard_watches_a_motion_whose_program_is_to_be_killed(monkeypatch):
    monkeypatch.setattr(Certifier, "_cases", lambda self, movers: self._ended(movers[0]))
    first = Certifier._stops
    monkeypatch.setattr(Certifier, "_stops", lambda self, mover: [next(iter(first(self, mover)))])
    certifier = certifier_of(load_profile("emulated/transient"))
    proofs = certifier.proofs()
    home = next(proofs)
    assert (home.limit, home.verdict) == ("home of stage", "acted"), home.acted
    low = {"force_n": 1e-6}  # the load cell's noise is more
    certifier.session.limits = certifier.session.limits.model_copy(update=low)
    (proof,) = proofs
    assert (proof.verdict, "limits.force_n" in proof.acted) == ("not shown", True), proof.acted


class LeftError(Exception):
    """The person has seen enough."""


def test_a_person_may_take_longer_than_a_watchdog_waits():
    profile, answers_s, proofs = load_profile("emulated/transient"), [], []

    def consent(text):
        if len(answers_s) == 2:
            raise LeftError
        answers_s.append(time.monotonic() + 1.5)  # real time: the board waits for a second
        return lambda: time.monotonic() > answers_s[-1]

    with pytest.raises(LeftError):
        for proof in certifier_of(profile, consent).proofs():
            proofs.append(proof)
    assert [(proof.limit, proof.verdict) for proof in proofs] == [
        (f"{what} of stage", "acted") for what in ("home", "stop")
    ]
