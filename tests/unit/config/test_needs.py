"""What the chosen trials use is opened and must be there; nothing else."""

from dataclasses import replace

import pytest

from config import assemble
from config.needs import may_move
from config.profile import load_profile, load_resolved
from config.source import ProfileError, profile_names, read_source
from config.trials import chosen
from controller.limits import shown_limits
from controller.registry import KINDS
from drivers.core.clock import VirtualClock
from drivers.core.errors import RefusedError
from drivers.core.line_sensor import LineSensor
from drivers.ur_arm.driver import UrArm
from tests.refusals import check_refusal, refused
from tests.unit.config.conftest import lab_values

HARDWARE = [name for name in profile_names() if name.startswith("hardware/") and "bench" not in name]


def opened(name, overrides=None, only=()):
    """The devices that the trials of a profile open."""
    profile = load_profile(name, overrides)
    return set(assemble.plan_campaign(profile, chosen(profile.trials(0), only), 0).devices)


def missing(name, overrides=None):
    """The dotted keys of the values that a profile asks for before anything is opened."""
    with pytest.raises(ProfileError) as refusal:
        opened(name, overrides)
    found = set()
    for line in refusal.value.problems:
        check_refusal(line, ".toml: [", "] ", " is not set: ")
        section, _, key = line.partition("[")[2].partition(" is not set")[0].partition("] ")
        found.add(f"{section}.{key}")
    return found


def sensor(name):
    """The trials of `slip` with one sensor."""
    return {"trials.list": f'[{{ sensor = "{name}" }}]'}


TOOL = ("start_pose", "approach_axis", "tcp_offset", "payload_kg", "payload_cog_m")
ARM = {f"devices.arm.{key}" for key in ("port", *TOOL)}
LIMITS = {"limits.force_n", "limits.travel_m"}
STAGE = {f"devices.stage.{key}" for key in ("port", "microstep_m", "travel_m")}
GRIPPER = {"devices.gripper.port", "devices.gripper.closed_width_m"}
BOARD, AUDIO, TIP = "devices.board.port", "devices.audio.port", "signals.tip.gain_v_n"
WAVEFORM = "detectors.ours.threshold"
APPROACH = "behavior.approach_limit_m"
PATH = {f"behavior.{key}" for key in ("clear_m", "sweep_m", "grip_width_m")}
SIDES = ("left", "right")
CENTERING = PATH | {f"detectors.{side}_{what}.threshold" for side in SIDES for what in ("paper", "contact")}
LISTENS = ("ours.threshold", "ours.level_fs", "contact.threshold")
GRASP = PATH | {
    *("limits.grip_n", "detectors.slip_ours.threshold", "signals.pad.overload_n"),
    *(f"behavior.{key}" for key in ("lift_m", "weight_n", "grip_force_n", "jaws_n", "tightest_n")),
    *(f"detectors.{side}_{what}" for side in SIDES for what in LISTENS),
}
PRETOUCH = {"detectors.pretouch_paper.threshold", "detectors.pretouch_ours.threshold"}


def slipping(stream, name, *thresholds):
    """What the trials of one sensor ask for."""
    asked = {f"behavior.sensors.{name}.press_m", "behavior.radius_m"}
    return ARM | LIMITS | asked | set(stream) | {f"detectors.{each}.threshold" for each in thresholds}


BORDER = slipping({BOARD, TIP}, "fingertip", "touch_fingertip", "fingertip_ours", "border")
HALF_FULL = {"behavior.light_m", "behavior.full_m"}
HELD = ARM | LIMITS | GRIPPER | {AUDIO}
TOUCHED = HELD | PRETOUCH | {"detectors.contact_ours.threshold"}
FIRST = {BOARD, "limits.travel_m", "detectors.contact.threshold", APPROACH}
FINGER = STAGE | LIMITS | {BOARD}

CASES = [
    ("first_contact", {}, "stage board operator", STAGE | FIRST),
    ("chirp", {}, "audio", {AUDIO}),
    ("weights", {}, "board operator", {BOARD}),
    ("static", {}, "stage board", FINGER | HALF_FULL),
    ("stiffness", {}, "stage board", FINGER | HALF_FULL),
    ("locating", {}, "stage board", FINGER | {"behavior.full_m"}),
    ("flexion", {}, "stage board", FINGER | {WAVEFORM, APPROACH, "behavior.flexed_m"}),
    ("proximal", {}, "stage board", FINGER | {WAVEFORM, APPROACH}),
    ("tradeoff", {}, "stage board", FINGER | {WAVEFORM, APPROACH}),
    ("transient", {}, "stage board", FINGER | {WAVEFORM, APPROACH}),
    ("transient_arm", {}, "arm board", ARM | LIMITS | {BOARD, WAVEFORM, APPROACH}),
    ("pointer", {}, "arm board", ARM | LIMITS | {BOARD, TIP}),
    *(
        ("slip", sensor(name), devices, slipping(streams, name, *thresholds.split()))
        for name, devices, streams, thresholds in (
            ("fingertip", "arm board", {BOARD, TIP}, "touch_fingertip fingertip_ours"),
            ("barrett_finger", "arm hand", {"devices.hand.port"}, "touch_arm barrett_paper barrett_ours"),
            ("wrist", "arm", (), "touch_arm wrist_paper wrist_ours"),
            ("dsa", "arm matrix", {"devices.matrix.port"}, "touch_dsa dsa_paper dsa_ours"),
        )
    ),
    *((name, {}, "arm gripper audio", HELD | PRETOUCH) for name in ("pretouch", "pretouch_y", "pretouch_z")),
    *((name, {}, "arm gripper audio", TOUCHED) for name in ("touch", "objects")),
    ("border", {}, "arm board", BORDER),
    ("centering", {"trials.grid.method": '["paper"]'}, "arm gripper audio", HELD | CENTERING),
    ("grasp", {}, "arm gripper audio board", HELD | {BOARD} | GRASP),
]
"""Profile, what is chosen of it, what is opened, and which values the lab has to give for that."""


@pytest.mark.parametrize(("name", "choice", "devices", "values"), CASES)
def test_a_hardware_profile_opens_and_asks_for_what_its_trials_use(name, choice, devices, values):
    name = f"hardware/{name}"
    given = lab_values(name)
    assert opened(name, given | choice) == set(devices.split())
    needless = {key: value for key, value in given.items() if key not in values}
    asked = missing(name, needless | choice)
    assert asked == values
    assert missing(name, choice) == asked


def test_every_hardware_profile_is_among_them():
    assert {f"hardware/{name}" for name, *_ in CASES} == set(HARDWARE)


PRINTED = {"fingertip_paper", "flexible_paper", "contact_paper", "touch"}
"""Detectors with a threshold that is the paper's, or the trial's factor."""

MOVING = {*TOOL, "microstep_m", "travel_m"}


@pytest.mark.parametrize("name", HARDWARE)
def test_on_hardware_nothing_that_moves_and_no_threshold_has_a_value_of_the_simulation(name):
    profile = load_profile(name)
    live = {
        f"devices.{device}.{key}"
        for device, entry in profile.devices.items()
        for key in ("port", *(MOVING & type(entry.settings).model_fields.keys()))
    } | {
        f"detectors.{detector}.threshold"
        for detector, entry in profile.detectors.items()
        if "threshold" in type(entry.settings).model_fields and detector not in PRINTED
    }
    if name != "hardware/weights":  # where nothing moves
        live |= LIMITS
    if name == "hardware/first_contact":  # its 0.3 N are what makes it one, on any bench
        live -= {"limits.force_n"}
    unset = {".".join(path) for path in profile.source.unset}
    console = {"devices.operator.port"}
    assert live - unset - console == set()


LAB = """
extends = "hardware/chirp"
devices.audio.port = "sounddevice:Scarlett"
"""


def test_a_lab_gives_its_values_in_a_profile_of_its_own_and_without_no_rig_is_made(tmp_path):
    (tmp_path / "lab.toml").write_text(LAB)
    assert opened(tmp_path / "lab.toml") == {"audio"}
    (tmp_path / "student.toml").write_text('extends = "lab"\ndevices.audio.port = "? which is free today"\n')
    assert missing(tmp_path / "student.toml") == {"devices.audio.port"}
    with refused(ProfileError, "[devices.audio] port is not set"):
        assemble.build_rig(load_profile("hardware/chirp"), devices={"audio"})


def test_a_client_that_is_missing_is_told_before_an_emulator_starts(monkeypatch):
    started = []
    monkeypatch.setattr(assemble, "start_emulator", lambda *given: started.append(given))
    monkeypatch.setattr(UrArm.link, "package", "no_such_client")
    monkeypatch.setattr(UrArm.link, "extra", "")
    profile = load_profile("emulated/transient_arm")
    with refused(RefusedError, "arm", "no_such_client is not installed", "pip install"):
        assemble.build_rig(profile)
    assert started == []
    with pytest.raises(AttributeError, match="endpoints"):  # without the arm it goes on
        assemble.build_rig(profile, devices=profile.devices.keys() - {"arm"})
    assert len(started) == 1


def test_a_trial_may_give_the_value_and_until_then_it_is_the_classes_own():
    values = {key: value for key, value in lab_values("hardware/transient").items() if "detectors" not in key}
    row = {"trials.list": '[{ location = "f", speed_m_s = 0.003, detectors.ours.threshold = 6.0 }]'}
    assert missing("hardware/transient", values) == {"detectors.ours.threshold"}
    assert opened("hardware/transient", values | row) == {"stage", "board"}
    source = read_source("hardware/transient")
    assert "microstep_m" not in source.data["devices"]["stage"]
    assert ("devices", "stage", "microstep_m") in source.unset


@pytest.mark.parametrize("name", ["hardware/slip", "mock/pointer", "mock/slip"])
def test_what_a_run_keeps_of_a_profile_loads_again(name):
    off = {"detectors.dsa_ours": "none", "devices.matrix": "none"} if "slip" in name else {}
    profile = load_profile(name, off)
    again = load_resolved(name, profile.resolved)
    assert again.hash == profile.hash
    assert again.source.absent == profile.source.absent


# --- simulated benches -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "overrides", "devices"),
    [
        ("mock/chirp", {}, {"audio"}),
        ("mock/slip", {}, {"arm", "board", "hand", "matrix"}),
        ("mock/slip", sensor("wrist"), {"arm"}),
        ("emulated/slip", sensor("fingertip") | {"behavior.measures": "[]"}, {"arm", "board"}),
        ("mock/pretouch", {}, {"arm", "gripper", "audio"}),
        ("mock/grasp", {}, {"arm", "gripper", "audio", "board"}),
    ],
)
def test_it_is_the_same_on_simulated_benches(name, overrides, devices):
    assert opened(name, overrides) == devices


def test_where_nothing_moves_no_limit_is_watched_and_one_that_was_not_given_is_not_shown():
    profile = load_profile("mock/chirp")
    (trial, *_) = assemble.plan_campaign(profile, profile.trials(0), 0).trials
    assert trial.guard.inputs == frozenset()
    profile = load_profile("mock/pretouch")
    (trial, *_) = assemble.plan_campaign(profile, profile.trials(0), 0).trials
    assert trial.guard.inputs == {"arm.force", "arm.position"}
    given = {"limits.force_n": "1.5", "limits.travel_m": "0.009"}
    assert list(shown_limits(assemble.limits_of(load_profile("hardware/transient")))) == []
    shown = shown_limits(assemble.limits_of(load_profile("hardware/transient", given)))
    assert [(what, limit) for what, _, _, limit, _ in shown] == [("force", 1.5), ("travel", 0.009)]


def test_what_is_taken_off_is_missed_only_by_trials_that_use_it():
    off = {"detectors.dsa_ours": "none", "devices.matrix": "none", "signals.tip": "none"}
    assert opened("mock/slip", off | sensor("wrist")) == {"arm"}
    assert opened("mock/slip", {"detectors.dsa_ours": "none"} | sensor("dsa")) == {"arm", "matrix"}
    for key, named in [("devices.matrix", "device 'matrix'"), ("signals.tip", "signal 'tip'")]:
        with pytest.raises(ProfileError) as refusal:
            opened("mock/slip", {key: "none"})
        for line in refusal.value.problems:
            check_refusal(line, named, '"none"')


def test_what_no_trial_uses_may_have_no_fault_and_an_emulator_that_lacks_a_device_is_not_joined():
    fault = {"faults": '[{ device = "arm", kind = "stall", at_s = 1.0 }]'}
    with refused(ProfileError, "mock/chirp", '[faults] #1 device = "arm"', "remove the fault"):
        opened("mock/chirp", fault)
    profile = load_profile("emulated/slip", sensor("wrist"))
    with refused(RefusedError, "arm", "emulate emulated/slip"):
        assemble._wire_devices(replace(profile, devices={"arm": profile.devices["arm"]}), VirtualClock(), {})


def test_the_limits_of_a_second_mover_ask_for_it_only_where_it_is_used():
    second = {"limits.movers.arm.travel_m": "0.1", "limits.movers.arm.speed_m_s": "0.1"}
    second |= {"limits.movers.arm.position_stream": "arm.position", "devices.arm.driver": "ur_arm"}
    second |= {"devices.arm.port": "mock", "devices.arm.start_pose": "[0.4, -0.1, 0.2, 0.0, 3.1, 0.0]"}
    second |= {"devices.arm.approach_axis": "[0.0, 0.0, -1.0]"}
    assert opened("mock/transient", second, [1]) == {"stage", "board"}


OWN = '''
from behaviors.machine import Behavior, StatePlan, on
from drivers.core.settings import Settings

COLUMNS = ()


class IdleSettings(Settings):
    """None."""


class Idle(Behavior):
    """Waits, and names no device."""

    table = (on("deadline", "WAITING", "DONE"),)

    def __init__(self, settings: IdleSettings, factors: IdleSettings, detectors: frozenset[str]) -> None:
        super().__init__({"WAITING": StatePlan(1.0)})


def measure(evidence, settings, outcome):
    return "waited", {}
'''


def test_an_experiment_that_names_no_device_may_command_any(tmp_path):
    (tmp_path / "idle.py").write_text(OWN)
    (tmp_path / "idle.toml").write_text('extends = "mock/bench_resonance"\nexperiment = "idle:Idle"\n')
    assert opened(tmp_path / "idle.toml") == {"stage", "board"}


@pytest.mark.parametrize("name", ["mock/transient", "mock/slip", "mock/pretouch", "mock/weights"])
def test_no_device_that_moves_is_registered_as_one_that_does_not(name):
    profile = load_profile(name)
    for device in assemble.build_rig(profile).devices.values():
        info = device.open()
        device.close()
        assert KINDS["driver"][profile.devices[device.name].kind].moves or not info.mover


def test_a_sensor_is_no_mover_that_stop_would_look_for_nor_is_a_users_own_that_sends_lines():
    moving = {name for name, driver in KINDS["driver"].items() if driver.moves}
    assert moving == {"zaber_stage", "sensor_board", "ur_arm", "franka_arm", "can_gripper", "robotiq"}
    board = load_profile("mock/transient").devices["board"]
    assert not may_move(replace(board, kind="my_lab:Cell", made=LineSensor))
    assert may_move(replace(board, kind="my_lab:Arm", made=UrArm))
