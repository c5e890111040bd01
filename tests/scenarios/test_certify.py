"""Every limit of every shipped bench acts when it is driven past, and one that does not fails the certificate."""

import json
import math
import os
import re
import select
import signal
import sys
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from config.abandoned import abandoned
from config.assemble import limits_of
from config.profile import load_profile
from config.source import profile_names, read_source
from config.verbs.certify import certified, certifier_of
from controller.certify import NOT_AT_REST, Certifier, Proof, Seam, Wrong
from controller.guard import Guard, GuardRefusal, GuardSettings
from controller.limits import Bounds, MoverLimits
from controller.redundancy import Followed
from drivers.core.errors import SilentError
from drivers.core.messages import Failed, MoveAt, Stop
from simulator.mocks.ur_arm import MockUrArm
from simulator.mocks.zaber_stage import MockZaberStage
from tests.refusals import check_refusal
from tests.unit.config.conftest import lab_values

BENCHES = (
    *("mock/first_contact", "mock/flexion", "mock/locating", "mock/transient_arm", "mock/weights"),
    *("mock/slip_calm", "mock/pointer"),
    *("mock/chirp", "mock/centering_turned", "mock/grasp"),
)
"""Profiles that have every device and every limit of the mock benches between them."""

BOUNDS = ("travel_m", "travel_min_m", "blind_travel_m", "speed_m_s", "reach_m", "reach_rad")

INPUTS = {"position_stream", "pose_stream", "force_stream", "force_channels", "force_median_s", "movers"} | {
    *("retreat_m", "stiffness_n_m", "braking_m_s2", "detector_delay_s")
}
"""What tells the guard where to look, and how: no limits themselves."""

BOX = {
    "limits.workspace_min_m": "[0.3, -0.2, 0.2]",
    "limits.workspace_max_m": "[0.5, 0.0, 0.3]",
    "limits.pose_stream": '"arm.pose"',
}


SLOWLY = {"loop.rate_hz": "50.0"}
"""Fewer turns than shipped are computed: what acts is the same, within the same times."""


def proved(name, consent=lambda text: None, **sets):
    return list(certifier_of(load_profile(name, SLOWLY | sets), consent).proofs())


CASES = ("_streams", "_forces", "_travel", "_asked", "_of_device", "_alone", "_watchdogs", "_ended")


def of(proofs, limit):
    return [proof for proof in proofs if proof.limit == limit]


@pytest.fixture
def only(monkeypatch):
    """Leaves out all cases but the first ones, lateness, and those of one kind."""

    def leave(kind=""):
        for cases in CASES:
            if cases != kind:
                monkeypatch.setattr(Certifier, cases, lambda *_: ())

    return leave


@pytest.fixture(scope="module")
def touch():
    """A bench with an arm and a gripper."""
    return proved("mock/touch")


def profiles(bench):
    names = [name for name in profile_names() if name.startswith(f"{bench}/")]
    return [name for name in names if "experiment" in read_source(name).data]


def devices_of(name):
    """Each device of a profile that moves or has a watchdog, with its settings and the bounds that it may move in."""
    profile = load_profile(name)
    limits = limits_of(profile)
    for device, entry in profile.devices.items():
        settings = entry.settings.model_dump(mode="json")
        bounds = limits.movers.get(device, limits).model_dump(include=set(BOUNDS))
        if settings.keys() & {"max_speed_m_s", "watchdog_s"}:
            moves = "max_speed_m_s" in settings
            yield json.dumps([entry.kind, settings, bounds if moves else {}], sort_keys=True)


def limits_set(name):
    """The limits that a profile has, and the kind of what is touched."""
    profile = load_profile(name)
    return {key for key, value in profile.limits.model_dump().items() if value} | {profile.plant.kind}


def test_each_device_and_limit_of_each_mock_bench_is_one_of_these():
    shown = {part for name in BENCHES for part in (*devices_of(name), *limits_set(name))}
    assert len(profiles("mock")) > 20
    for name in profiles("mock"):
        assert {*devices_of(name), *limits_set(name)} <= shown, name


@pytest.mark.parametrize("name", BENCHES)
def test_every_limit_of_a_shipped_mock_bench_acts(name):
    proofs = proved(name)
    bad = [proof for proof in proofs if proof.verdict not in ("acted", "nothing to bound")]
    assert not bad
    moving = [proof for proof in proofs if proof.way_m is not None]
    assert all(math.isfinite(proof.way_m) and proof.way_m < 2.3e-3 for proof in moving)
    assert bool(moving) == (name not in ("mock/chirp", "mock/weights"))  # there nothing moves


FURTHER = {
    "limits.range_streams": '["board.load_cell"]',
    "limits.retreat_n": "4.0",
    "limits.peak_n": "3.0",
    "limits.agree.both": '{ streams = ["board.load_cell", "board.accelerometer"], most = 50.0 }',
}
"""What no shipped bench has."""


def test_no_setting_of_the_guard_is_left_out(touch):
    proofs = [*proved("mock/transient_arm", **BOX, **FURTHER), *touch]
    assert certified(proofs)
    shown = {key for proof in proofs for key in proof.limit.split(".")}
    assert set(GuardSettings.model_fields) - shown - INPUTS == set()
    assert shown >= set(MoverLimits.model_fields) - INPUTS


def test_stop_and_pause_come_before_anything_else_goes_wrong(touch):
    limits = [proof.limit for proof in touch]
    first = next(place for place, limit in enumerate(limits) if "." in limit)
    assert {limit.partition(" ")[0] for limit in limits[:first]} == {"home", "stop", "pause"}
    assert {limit.rpartition(" ")[2] for limit in limits[:first]} == {"arm", "gripper"}


def test_limits_of_devices_come_in_the_order_of_the_profile():
    profile = load_profile("mock/grasp")
    assert list(certifier_of(profile)._settings) == list(profile.devices)


DEFECTS = [
    ("mock/transient", Guard, "_force", "_forces", {"limits.force_n", "limits.retreat_n"}),
    ("mock/transient", Guard, "way_out", "_forces", {"limits.retreat_n"}),
    ("mock/transient", Followed, "see", "_travel", {"limits.follow_m"}),
    ("mock/transient", Bounds, "position", "_travel", {"limits.travel_m", "limits.travel_min_m"}),
    ("mock/transient", Bounds, "admit_speed", "_asked", {"limits.speed_m_s"}),
    ("mock/transient", MockZaberStage, "_look", "_alone", {"limits.blind_travel_m"}),
    ("mock/transient_arm", MockUrArm, "_look", "_alone", {"limits.blind_travel_m", "devices.arm.loop_timeout_s"}),
]  # fmt: skip
"""What does nothing any more, and in cases of which kind that must show."""


def test_a_gripper_that_goes_no_slower_is_driven_past_its_limits_at_its_least_speed():
    proofs = proved("tests/data/robotiq.toml")
    assert certified(proofs)
    assert "gripper at 20 mm/s" in " ".join(proof.done for proof in proofs)


@pytest.mark.parametrize(("name", "owner", "method", "cases", "limits"), DEFECTS)
def test_a_limit_that_does_not_act_fails_the_certificate(
    only, monkeypatch, name, owner, method, cases, limits
):
    only(cases)
    monkeypatch.setattr(owner, method, lambda *_, **__: None)
    proofs = proved(name)
    assert not certified(proofs)
    assert {proof.limit for proof in proofs if proof.verdict == "failed"} == limits


def test_what_kept_a_command_from_being_refused_is_named(only, monkeypatch):
    only("_asked")
    admit = Bounds.admit_speed

    def silent(*given):
        try:
            admit(*given)
        except GuardRefusal:
            raise SilentError("board", "reading", "board.period is silent", "look at its cable") from None

    monkeypatch.setattr(Bounds, "admit_speed", silent)
    (failed,) = [proof for proof in proved("mock/transient") if proof.verdict == "failed"]
    assert failed.limit == "limits.speed_m_s"
    assert "board.period is silent" in failed.acted


def test_a_device_that_fails_while_a_command_is_refused_is_named_and_the_guard_is_not_blamed(
    only, monkeypatch
):
    only("_asked")
    admit, poll, refused = Bounds.admit_speed, MockZaberStage.poll, []

    def then_unplugged(*given):
        try:
            admit(*given)
        except GuardRefusal:
            refused.append(True)
            raise

    def unplugged(self):
        failed = [Failed(self._clock.now(), self.name, "it answers nothing")] if refused else []
        return [*poll(self), *failed]

    monkeypatch.setattr(Bounds, "admit_speed", then_unplugged)
    monkeypatch.setattr(MockZaberStage, "poll", unplugged)
    proofs = proved("mock/transient")
    failed, *others = proofs[[proof.verdict for proof in proofs].index("failed") :]
    assert (failed.limit, failed.verdict) == ("limits.speed_m_s", "failed")
    assert failed.acted.startswith("guard refused; it answers nothing")
    assert others
    assert {(each.verdict, "stage failed (it answers nothing)" in each.acted) for each in others} == {
        ("not tried", True)
    }


def test_silence_and_lateness_that_nobody_notices_fail_it(only, monkeypatch):
    only("_streams")
    check = Guard.check
    monkeypatch.setattr(
        Guard,
        "check",
        lambda self, t_s, blocks, moving, late_s=0.0, saturated=(): check(self, t_s, blocks, moving),
    )
    monkeypatch.setattr("controller.arrivals.Arrivals._silent", lambda *_: None)
    failed = {proof.limit for proof in proved("mock/transient") if proof.verdict == "failed"}
    assert failed == {"limits.stale_s", "limits.late_s"}


def test_a_late_loop_is_seen_by_the_guard_before_the_movers_own_process_acts(only):
    only()
    settings = {"limits.late_s": "0.4", "devices.arm.loop_timeout_s": "0.5"}
    (done,) = [proof.done for proof in of(proved("mock/transient_arm", **settings), "limits.late_s")]
    (away_s,) = re.findall(r"away for (\S+) s", done)
    assert 0.4 < float(away_s) < 0.5


def test_a_bench_that_does_not_stop_is_driven_past_nothing(monkeypatch):
    axis_stop = "simulator.physics.stage_axis.StageAxis.stop"
    monkeypatch.setattr(axis_stop, lambda self, *_: None)
    proofs = proved("mock/transient")
    failed = [proof for proof in proofs if proof.verdict == "failed"]
    assert [proof.limit for proof in failed] == ["stop of stage"]
    assert NOT_AT_REST in failed[0].acted
    assert {proof.verdict for proof in proofs[proofs.index(failed[0]) + 1 :]} == {"not tried"}


def test_a_person_is_asked_before_each_motion_and_may_end_it():
    asked = []

    class EndedError(Exception):
        pass

    def consent(text):
        asked.append(text)
        if len(asked) == 3:
            raise EndedError

    with pytest.raises(EndedError):
        proved("mock/transient", consent)
    assert ["home" in asked[0], *("1 mm/s" in text for text in asked[1:])] == [True, True, True]
    assert all("stage" in text for text in asked)


def test_a_mover_of_which_nothing_is_known_is_no_bench_on_which_nothing_moves(monkeypatch):
    monkeypatch.setattr(Certifier, "_mover", lambda self, name: None)
    found = {proof.limit: proof for proof in proved("mock/transient")}
    assert "AxisLimits" in found["limits.force_n"].acted
    assert found["limits of stage"].verdict == "not shown"


def test_the_verb_writes_a_certificate_and_its_exit_code_says_it(verb, tmp_path, monkeypatch):
    code, out, _ = verb("certify", "mock/weights", "--out", tmp_path)
    assert code == 0
    assert "4 of 4 limits acted" in out
    (folder,) = tmp_path.iterdir()
    document = json.loads((folder / "certificate.json").read_text())
    assert document["certified"]
    assert {limit["limit"] for limit in document["limits"]} >= {
        "limits.stale_s",
        "devices.board.tendon_max_m",
    }
    assert "| limits.stale_s | 0.1 s |" in (folder / "certificate.md").read_text()
    monkeypatch.setattr("controller.arrivals.Arrivals._silent", lambda *_: None)
    code, out, _ = verb("certify", "mock/weights", "--out", tmp_path)
    assert code == 1
    assert "3 of 4 limits acted; 1 failed" in out


def document_of(out):
    (path,) = out.glob("*/certificate.json")
    return json.loads(path.read_text())


SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT]


@pytest.mark.parametrize("number", SIGNALS)
def test_whatever_ends_it_stops_what_moves_and_leaves_a_certificate(
    verb, tmp_path, monkeypatch, at_terminal, number
):
    apply, sent = MockZaberStage.apply, []

    def applied(self, command):
        if isinstance(command, MoveAt):
            signal.raise_signal(number)
        sent.append(command)
        return apply(self, command)

    monkeypatch.setattr(MockZaberStage, "apply", applied)
    code, _, err = verb("certify", "mock/transient", "--set", "loop.rate_hz=50", "--out", tmp_path)
    assert (code, err.strip()) == (130, "interrupted")
    kinds = [type(command) for command in sent]
    assert Stop in kinds[kinds.index(MoveAt) :]
    assert kinds.count(MoveAt) == 1, "no other case began"
    assert document_of(tmp_path)["summary"] == "1 of 1 limits acted; interrupted"
    assert not document_of(tmp_path)["certified"]


def test_ctrl_z_suspends_no_program_whose_bench_moves(verb, tmp_path, monkeypatch, at_terminal, only):
    only()
    requested = Wrong.requested
    monkeypatch.setattr(
        Wrong, "requested", lambda self: (signal.raise_signal(signal.SIGTSTP), requested(self))[1]
    )
    assert verb("certify", "mock/transient", "--set", "loop.rate_hz=50", "--out", tmp_path)[0] == 0


@pytest.mark.parametrize("paused", [False, True])
def test_a_stop_while_it_pauses_by_itself_is_not_taken_for_its_own(only, monkeypatch, paused):
    only()
    requested, pressed = Wrong.requested, []

    def then_pressed(self):
        request = requested(self)
        if self.pauses and (request == "abort" if paused else True):
            pressed.append(True)
        return request

    monkeypatch.setattr(Wrong, "requested", then_pressed)
    certifier = certifier_of(load_profile("mock/transient", SLOWLY), stopped=lambda: bool(pressed))
    proofs = []
    with pytest.raises(KeyboardInterrupt):
        proofs.extend(certifier.proofs())
    stage: Any = certifier.session.rig.devices["stage"]
    assert not stage.axis.moving(certifier.session.rig.clock.now())


@pytest.mark.parametrize(
    ("name", "limit"), [("mock/transient", "home of stage"), ("mock/weights", "limits.stale_s")]
)
def test_a_limit_whose_stream_no_device_sends_fails_and_the_certificate_says_why(verb, tmp_path, name, limit):
    wrong = ("--set", "limits.force_stream=board.lode_cell", "--set", "limits.force_n=1.0")
    code, _, err = verb("certify", name, *wrong, "--out", tmp_path)
    assert (code, err) == (1, "")
    failed = [each for each in document_of(tmp_path)["limits"] if each["verdict"] == "failed"]
    assert failed[0]["limit"] == limit
    assert "board.lode_cell" in failed[0]["acted"]


def test_an_unforeseen_error_leaves_a_certificate_of_what_acted(verb, tmp_path, monkeypatch):
    def broken(*_):
        raise RuntimeError("a bug")

    monkeypatch.setattr(Certifier, "_streams", broken)
    code, _, err = verb("certify", "mock/transient", "--set", "loop.rate_hz=50", "--out", tmp_path)
    assert code == 1
    check_refusal(err.strip(), "RuntimeError: a bug")
    found = document_of(tmp_path)
    assert not found["certified"]
    assert "a bug" in found["summary"]
    assert [each["verdict"] for each in found["limits"]] == ["acted"] * 3


def test_a_device_that_sent_nothing_shows_nothing_of_its_watchdog(monkeypatch):
    read = Seam.read

    def unheard(self):
        blocks = read(self)
        self.last_s = -math.inf
        return blocks

    monkeypatch.setattr(Seam, "read", unheard)
    certifier = certifier_of(load_profile("mock/weights", SLOWLY))
    away, planned = Certifier._away("board", 2.0), Proof("devices.board.watchdog_s", "1 s", "left alone")
    with certifier.session:
        found = certifier._guarded_by("board", [], away, 1.0, planned)
    assert (found.verdict, found.acted) == ("not shown", "it sent nothing before it was left alone")


@pytest.mark.parametrize(
    ("typed", "agreed", "code"),
    [([b"\n"], [True], 0), ([b"yes\n", b" \n"], [False, True], 0), ([b"no\n"], [], 130), ([b"N\n"], [], 130)],
)
def test_only_an_empty_line_agrees_to_a_motion_and_no_ends(
    verb, tmp_path, monkeypatch, at_terminal, typed, agreed, code
):
    answers = []

    def certifier(loaded, consent, stopped):
        def proofs():
            ask = consent("stage moves")
            for line in typed:
                assert not ask()
                os.write(at_terminal, line)
                assert select.select([sys.stdin], [], [], 100.0)[0]
                answers.append(ask())
            yield Proof("stop of stage", "", "it moved", "acted")

        return SimpleNamespace(proofs=proofs, session=SimpleNamespace(infos={}))

    monkeypatch.setattr("config.verbs.certify.certifier_of", certifier)
    values = [f"--set={key}={value}" for key, value in lab_values("hardware/transient").items()]
    ended, out, _ = verb("certify", "hardware/transient", *values, "--out", tmp_path)
    assert (ended, answers) == (code, agreed)
    assert out.count("stage moves: press Enter") == 1 + agreed.count(False)


@pytest.mark.parametrize(("went_m", "verdict"), [(0.001, "acted"), (0.0025, "failed"), (None, "not shown")])
def test_a_program_that_is_killed_leaves_a_mover_that_stops_or_fails_the_certificate(only, went_m, verdict):
    only("_ended")

    @contextmanager
    def abandoned(mover, frozen):
        if went_m is None:
            raise EOFError
        rig = certifier.session.rig
        stage: Any = rig.devices["stage"]
        yield stage.axis.position(rig.clock.now()) - went_m

    certifier = certifier_of(load_profile("mock/transient"))
    certifier.abandoned = abandoned
    proofs = list(certifier.proofs())
    (killed,) = [proof for proof in proofs if "killed" in proof.done]
    assert (killed.limit, killed.verdict) == ("limits.blind_travel_m", verdict)
    assert certified(proofs) == (verdict == "acted")


def test_a_program_that_is_to_be_killed_is_not_waited_for_where_a_person_ends_the_certificate():
    rig = SimpleNamespace(endpoints=None, devices={})
    session: Any = SimpleNamespace(rig=rig, limits=None, scene=None)
    mover: Any = None
    gone = abandoned(load_profile("mock/transient"), session, lambda: True, mover, False)
    with pytest.raises(KeyboardInterrupt), gone:
        pass


def test_a_mover_that_shows_nothing_is_not_taken_to_stand_still(monkeypatch):
    found = Certifier._mover
    monkeypatch.setattr(
        Certifier, "_mover", lambda self, name: found(self, name)._replace(shown="stage.elsewhere")
    )
    first, *others = proved("mock/transient")
    assert (first.limit, first.verdict) == ("home of stage", "failed")
    assert {proof.verdict for proof in others} == {"not tried"}
