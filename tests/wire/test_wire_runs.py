"""Whole approaches of stage and arm through real drivers, ptys and emulated devices, and what pulls them down."""

import time
from contextlib import closing

import numpy as np
import pytest

from config.assemble import build_rig, start_emulator
from config.profile import load_profile
from controller.campaign import EXIT_DEVICE, EXIT_DONE
from controller.contracts import tried
from controller.doctor import examine
from controller.recording.reader import open_run
from controller.rig import TrialScene
from drivers.core.messages import Home, Listen, MoveAt, MoveTo, Reached, Stalled
from tests.contracts.device_suite import Bench
from tests.wire.wire_campaign import QUICK, run

STAGE, ARM = "emulated/transient", "emulated/transient_arm"


def settings_of(name):
    return {} if name == "emulated/centering" else QUICK


@pytest.fixture
def emulated(request):
    """A profile and an emulator of it that outlives the run, so that one can look at the bench afterwards."""
    profile = load_profile(request.param, settings_of(request.param))
    with closing(start_emulator(profile)) as emulator:
        yield profile, emulator


@pytest.fixture(scope="module")
def lasting():
    """The same for tests that leave the bench as they found it: each emulator is started once."""
    started = {}

    def get(name):
        if name not in started:
            profile = load_profile(name, settings_of(name))
            started[name] = profile, start_emulator(profile)
        return started[name]

    yield get
    for _, emulator in started.values():
        emulator.close()


def scene_of(profile):
    return TrialScene(1, 1, {}, profile.plant.settings.model_dump(mode="json"))


@pytest.mark.parametrize("name", [STAGE, ARM])
def test_an_approach_over_the_wire_ends_by_contact(lasting, tmp_path, name):
    profile, emulator = lasting(name)
    outcome, hand = run(profile, emulator, tmp_path)
    assert outcome.exit_code == EXIT_DONE, outcome.line
    assert hand.seen[-1] == "DONE"
    done = open_run(outcome.folder)
    (row,) = done.trials
    assert row["outcome"] == "contact"
    assert row["onset_s"] < row["detect_s"] < row["command_s"] < row["standstill_s"]
    # 4.843 mm/s from the onset to the detection, through two devices' clocks, each known to a few milliseconds
    assert row["extent_m"] == pytest.approx(0.004843 * row["delay_s"], abs=6e-5)
    assert not done.trial(2).stream("board.load_cell").gaps
    assert (done.manifest["bench"], done.manifest["clock"]) == ("emulated", "held")
    if "arm" not in profile.devices:
        return
    position = done.trial(2).stream("arm.position")
    at_m = float(np.interp(row["onset_s"], position.times_s, position.values[:, 0]))
    # The finger's surface is at 3 mm, and swings towards the probe by up to half a millimetre.
    assert 0.0024 < at_m < 0.0032
    assert done.manifest["roles"]["mover"] == "arm"
    assert done.manifest["devices"]["arm"]["link"]["rows"] > 500
    assert emulator.endpoints["devices"]["arm"]["host"].startswith("127.0.0.")


@pytest.mark.parametrize(("emulated", "device"), [(STAGE, "board"), (ARM, "arm")], indirect=["emulated"])
def test_a_pulled_plug_stops_the_bench_and_says_which(emulated, tmp_path, device):
    profile, emulator = emulated
    outcome, _ = run(profile, emulator, tmp_path, {"APPROACH": lambda: emulator.inject(device, "unplug")})
    assert outcome.exit_code == EXIT_DEVICE
    assert "trial 2" in outcome.line
    assert "\n" not in outcome.line
    done = open_run(outcome.folder)
    assert done.trials[0]["outcome"] == "fault"
    # The arm is tried again for a while, but not in this trial.
    faults = [event for event in done.events if event["event"] in ("Failed", "Stalled")]
    assert faults[0]["device"] == device
    assert emulator.scene()["probe_m_s"] == 0.0
    assert len(done.trial(2).stream("board.load_cell")) > 500, "what was measured is kept"


@pytest.mark.parametrize("emulated", [STAGE], indirect=True)
def test_a_stall_ends_the_run(emulated, tmp_path):
    profile, emulator = emulated
    # Under way: the state is reported before its command is given.
    stall = {"APPROACH": lambda: emulator.inject("stage", "stall", after_s=0.2)}
    outcome, _ = run(profile, emulator, tmp_path, stall)
    assert outcome.exit_code == EXIT_DEVICE
    assert "stalled" in outcome.line
    assert emulator.scene()["probe_m_s"] == 0.0


@pytest.mark.parametrize(
    ("name", "named"),
    [
        (STAGE, ("board.load_cell", "stage.position")),
        (
            "emulated/centering",
            ("UR5", "SSG-48", "emulated recorder", "arm.position", "gripper.width", "audio.fingers"),
        ),
    ],
)
def test_the_doctor_reads_every_sensor_and_moves_nothing(lasting, name, named):
    profile, emulator = lasting(name)
    before = emulator.scene()
    with closing(build_rig(profile, emulator.endpoints)) as rig:
        findings = list(examine(rig, scene_of(profile)))
    lines = "\n".join(finding.line for finding in findings)
    # by the wall clock: a busy machine does lose rows of an arm, and the doctor is right to say so
    failed = [
        finding.line
        for finding in findings
        if finding.verdict == "fail" and not ("samples lost" in finding.line and "arm." in finding.line)
    ]
    assert not failed, lines
    assert [each for each in named if each not in lines] == []
    after = emulator.scene()
    places = [key for key in ("probe_m", "probe_m_s", "tool_x_m", "width_m") if key in before]
    assert len(places) == 2
    assert {key: after[key] for key in places} == pytest.approx(
        {key: before[key] for key in places}, abs=1e-9
    )


def test_stage_and_board_keep_their_contract(lasting):
    profile, emulator = lasting(STAGE)
    with closing(build_rig(profile, emulator.endpoints)) as rig:
        lines = [each.line for each in tried(rig, scene_of(profile), ["stage", "board"], {}, {}, {}, {})]
    assert ["keeps the contract" in line for line in lines] == [True, True], lines


@pytest.fixture
def bench(lasting):
    """The arm's, at the beginning of a trial; with its profile, its emulator and its rig."""
    profile, emulator = lasting(ARM)
    with closing(build_rig(profile, emulator.endpoints)) as rig:
        rig.begin_trial(scene_of(profile))
        yield Bench(rig), profile, emulator, rig
        for device in rig.devices.values():
            device.close()


def test_the_arm_feels_what_the_load_cell_feels(bench):
    bench, *_ = bench
    for command in (Home("arm"), MoveTo("arm", 0.010, 0.015)):
        bench.apply(command)
        bench.until(Reached, "arm")
    for name, stream in (("arm", "arm.force"), ("board", "board.load_cell")):
        bench.apply(Listen(name, frozenset({stream})))
    bench.turn(1.0)
    felt, pressed_n = bench.values("arm.force").mean(axis=0), bench.values("board.load_cell").mean()
    assert pressed_n > 0.15, "7 mm into the finger"
    # Five standard errors of 500 samples of 0.5 N. The tool moves downwards, and the finger presses it upwards.
    assert felt[:3] == pytest.approx([0.0, 0.0, pressed_n], abs=0.12)


def test_a_loop_that_hangs_is_caught_by_the_arm_s_process_for_the_bench_goes_on_without_it(bench):
    bench, profile, emulator, rig = bench
    bench.apply(Home("arm"))
    bench.until(Reached, "arm")
    bench.apply(MoveAt("arm", 0.001, 0.012))
    bench.turn(0.2)
    began_s = rig.clock.now()
    assert emulator.scene()["probe_m_s"] == pytest.approx(0.001, rel=0.01)
    # a real hang, on the wall's clock: the bench's patience, the process's, the time to brake
    gone_s = time.monotonic() + 60.0
    while emulator.scene()["probe_m_s"] != 0.0:
        assert time.monotonic() < gone_s, "the arm goes on for ever"
        time.sleep(0.05)
    assert rig.clock.now() - began_s > profile.devices["arm"].settings.loop_timeout_s
    bench.until(Stalled, "arm")
