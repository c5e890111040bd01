"""From a profile to its bench, and to what is run on it; what simulates one is loaded where there is one."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from behaviors.machine import Behavior
from config.hints import near_or_all
from config.needs import Needs, needs_of, refuse_missing, within
from config.profile import Profile
from config.sections import referred
from config.source import ProfileError, given_value
from config.trials import Trial, distinct
from config.validation import validated
from controller.campaign import CampaignPlan, TrialPlan
from controller.detectors.protocol import Detector
from controller.guard import Guard, GuardSettings
from controller.outcomes import UNMEASURED
from controller.own_modules import KindError, found, is_own, own_files
from controller.registry import KINDS, experiment_of, find, row
from controller.rig import Rig, TrialScene
from controller.signals.protocol import Signal
from drivers.core.clock import Clock, VirtualClock, WallClock
from drivers.core.errors import PROGRAM, RefusedError
from drivers.core.protocols import Device

if TYPE_CHECKING:
    from simulator.devices.faults import FaultSchedule
    from simulator.wiring.emulator_process import EmulatorProcess


# --- the bench -----------------------------------------------------------------------------------


def build_rig(
    profile: Profile,
    endpoints: Mapping[str, Any] | None = None,
    realtime: bool = False,
    devices: Collection[str] | None = None,
    moves: bool = False,
) -> Rig:
    """The profile's bench, its devices still closed.

    Args:
        endpoints: What an emulator that runs already has printed; where there are none, an emulated bench starts
            its own, which ends with the rig.
        realtime: Whether an emulated bench of its own follows the wall clock, even when this program is late; beside
            a real port it does in any case.
        devices: Those that are there; None is all of the profile. `CampaignPlan.devices` are those that its trials use.
        moves: Whether one of them is to move by hand: then the limits need all their values as well.

    Raises:
        ProfileError: a setting of theirs that the lab has to give has no value.
        RefusedError: a real port beside an emulator that runs already and whose time may pause; or, before an
            emulator starts, a library that a device needs is not installed.
    """
    profile = _with_devices(profile, devices, moves)
    if profile.bench == "mock":
        return _mock_rig(profile)
    if profile.bench == "emulated":
        return _emulated_rig(profile, endpoints, realtime)
    clock = WallClock()
    return Rig("hardware", _wire_devices(profile, clock, {}), clock, time="wall")


def _with_devices(profile: Profile, devices: Collection[str] | None, moves: bool = False) -> Profile:
    """The profile with some of its devices alone, each with all values that the lab has to give."""
    kept = {name: each for name, each in profile.devices.items() if devices is None or name in devices}
    refuse_missing([(profile, None, Needs.of_devices(kept, moves))])
    return replace(profile, devices=kept)


def _wire_devices(
    profile: Profile,
    clock: Clock,
    ports: Mapping[str, Mapping[str, Any]],
    faults: Mapping[str, FaultSchedule] | None = None,
) -> dict[str, Device]:
    """Real drivers; `ports` holds the addresses of the emulated ones; other devices keep their own port. Faults of what
    a sensor reads are seen in the drivers' samples."""
    devices = {}
    for name, entry in profile.devices.items():
        if entry.port == "emulated" and name not in ports:
            raise RefusedError(
                name,
                "being joined",
                "the emulator that runs does not have it",
                f"start that one with this profile and these settings: {PROGRAM} emulate {profile.name}",
            )
        there = dict(ports[name]) if entry.port == "emulated" else {}
        settings = entry.settings.model_copy(update=there)
        made = entry.made
        if faults and faults[name].any:
            from simulator.devices.faults import faulty

            made = faulty(made, faults[name])
        devices[name] = made(name, settings, clock)
    return devices


def _emulated_rig(profile: Profile, endpoints: Mapping[str, Any] | None, realtime: bool) -> Rig:
    from simulator.devices.faults import disk_takes_s
    from simulator.wiring.bench_clock import BenchClock, ClockPage
    from simulator.wiring.emulator_process import EmulatorControl

    if endpoints and profile.real_ports and not endpoints.get("realtime"):
        raise RefusedError(
            "emulator",
            "being joined",
            f"its time may pause, and {next(iter(profile.real_ports))}, at a real port, would not",
            f"start it in real time: {PROGRAM} emulate {profile.name} --realtime",
        )
    for name, entry in profile.devices.items() if endpoints is None else ():
        if check := getattr(entry.made, "check_installed", None):
            check(name)  # before the emulator is compiled
    emulator = start_emulator(profile, realtime) if endpoints is None else EmulatorControl(endpoints)
    clock = BenchClock(ClockPage(emulator.endpoints["clock"]))

    faults = _schedules(profile, profile.devices, emulator.mark)
    devices = _wire_devices(profile, clock, emulator.endpoints["devices"], faults)
    faults |= _schedules(profile, ["disk"])  # of which the emulator knows nothing

    def begin_trial(scene: TrialScene) -> None:
        emulator.begin_trial(scene.trial, scene.seed, scene.factors, scene.plant)
        for name, schedule in faults.items():
            schedule.restart(scene.trial)
            if schedule.any and name in devices:
                devices[name].restart()  # type: ignore[attr-defined]

    def account() -> Mapping[str, Any]:
        found = dict(emulator.account())
        effects = found.pop("faults", []) + _shown(faults).get("faults", [])
        return {**found, **({"faults": effects} if effects else {})}

    return Rig(
        "emulated",
        devices,
        clock,
        begin_trial=begin_trial,
        account=account,
        entered=partial(_entered, faults),
        place=lambda: _metres(emulator.scene()),
        disk=lambda: disk_takes_s(faults["disk"], clock.now()),
        endpoints=emulator.endpoints,
        close=emulator.close,
        time="wall" if emulator.endpoints.get("realtime") else "held",
    )


def start_emulator(
    profile: Profile, realtime: bool = False, devices: Collection[str] | None = None
) -> EmulatorProcess:
    """Start the process that holds the profile's plant and emulated devices; its `endpoints` are their addresses.

    Args:
        realtime: Whether time follows the wall clock, even when this program is late; beside a real port it does in
            any case, for that device's samples would be dated by a clock that pauses.
        devices: As `build_rig`.
    """
    from simulator.wiring.emulator_process import EmulatorProcess

    scene = emulator_scene(_with_devices(profile, devices))
    return EmulatorProcess({**scene, "realtime": realtime or bool(profile.real_ports)})


def emulator_scene(profile: Profile) -> dict[str, Any]:
    """What the emulator's process gets of a profile.

    Raises:
        ProfileError: the profile has no emulated device.
    """
    if profile.plant is None or profile.bench != "emulated":
        raise ProfileError(
            f'{profile.name}: no device has port = "emulated"; try emulated/{profile.experiment}'
        )
    return {
        "plant": {
            "made": _dotted(profile.plant.made),
            "settings_class": _dotted(type(profile.plant.settings)),
            "folders": [str(folder) for folder in profile.source.folders],
            "settings": profile.plant.settings.model_dump(mode="json"),
        },
        "devices": {
            name: {
                "made": row("driver", entry.kind, profile.source.folders).emulated,
                "settings": entry.settings.model_dump(mode="json"),
                "settings_class": _dotted(type(entry.settings)),
            }
            for name, entry in profile.devices.items()
            if entry.port == "emulated"
        },
        "faults": [fault.model_dump(mode="json") for fault in profile.faults],
    }


def scene_check(profile: Profile, devices: Collection[str]) -> Callable[[TrialScene], object]:
    """What a simulated bench says of a trial's scene before it begins: it raises `RefusedError`; a real one nothing.

    Raises:
        DeviceError: devices of an emulated bench do not go together.
    """
    if profile.plant is None:
        return lambda scene: None
    if profile.bench == "emulated":
        from simulator.wiring.emulator import wired

        plant, _ = wired(emulator_scene(_with_devices(profile, devices)))
    else:
        plant = profile.plant.make("plant")
    check = getattr(plant, "check", lambda factors, settings: None)  # a plant of the user's own may have none
    return lambda scene: check(scene.factors, scene.plant)


def _dotted(made: Any) -> str:
    return f"{made.__module__}:{made.__name__}"


def _mock_rig(profile: Profile) -> Rig:
    from simulator.devices.faults import OF_THE_BENCH, FaultyClock, Keys, disk_takes_s, faulty
    from simulator.look_ahead import LookAhead

    assert profile.plant is not None
    faults = _schedules(profile, [*profile.devices, *OF_THE_BENCH])
    clock = FaultyClock(faults["loop"]) if faults["loop"].any else VirtualClock()
    bench = profile.plant.make("plant")
    devices = {}
    for name, entry in profile.devices.items():
        made = faulty(entry.made, faults[name]) if faults[name].any else entry.made
        devices[name] = made(name, entry.settings, clock, bench, faults[name])

    wrong = [schedule for schedule in faults.values() if schedule.any]
    ahead = LookAhead(clock, bench, list(devices.values()), wrong)

    def begin_trial(scene: TrialScene) -> None:
        ahead.restart()
        bench.restart()
        bench.begin(0.0, scene.seed, scene.trial, scene.factors, scene.plant)
        for device in devices.values():
            device.restart()
        for schedule in faults.values():
            schedule.restart(scene.trial)

    more = [name for name in ("slips", "lifts", "slides") if hasattr(bench, name)]
    return Rig(
        "mock",
        devices,
        clock,
        begin_trial=begin_trial,
        known=lambda: {"truth": bench.contacts} | {name: getattr(bench, name) for name in more},
        account=lambda: {**bench.account(), **_shown(faults)},
        place=lambda: _metres(bench.scene(clock.now())),
        ahead=ahead.skip,
        entered=partial(_entered, faults),
        pressed=Keys(faults["keys"], clock).pressed,
        disk=lambda: disk_takes_s(faults["disk"], clock.now()),
    )


def _schedules(
    profile: Profile, devices: Iterable[str], tell: Callable[[str, str], None] | None = None
) -> dict[str, FaultSchedule]:
    """What goes wrong with each of these, of all trials; `tell` is told device and mark."""
    from simulator.devices.faults import FaultSchedule

    return {
        name: FaultSchedule(
            [fault for fault in profile.faults if fault.device == name], tell and partial(tell, name)
        )
        for name in devices
    }


def _entered(faults: Mapping[str, FaultSchedule], state: str, t_s: float) -> None:
    """A trial enters a state."""
    for schedule in faults.values():
        schedule.mark(state, t_s)


def _shown(faults: Mapping[str, FaultSchedule]) -> dict[str, Any]:
    """Which faults took effect, for the manifest."""
    shown = [effect for schedule in faults.values() for effect in schedule.shown()]
    return {"faults": shown} if shown else {}


def _metres(scene: Mapping[str, float]) -> Mapping[str, float]:
    """The places in a scene."""
    return {name: value for name, value in scene.items() if name.endswith("_m")}


# --- what is run on it ---------------------------------------------------------------------------


def plan_campaign(
    profile: Profile,
    trials: Sequence[Trial],
    seed: int,
    *,
    done: Collection[int] = (),
    asked: Mapping[str, Any] | None = None,
    devices: Collection[str] | None = None,
) -> CampaignPlan:
    """What is to be run, trial by trial.

    Args:
        trials: In the order of running.
        done: Numbers of trials that were run before.
        asked: The arguments of the command line, for the manifest.
        devices: What the campaign opens of which these are a part; None is what these use.

    Raises:
        ProfileError: a trial that its behavior cannot run, a detector that it arms and the profile has not, a value
            that the lab has to give, or a fault of a device that no trial uses.
    """
    devices = _used_devices(profile, trials) if devices is None else devices
    experiment = experiment_of(profile.experiment)
    measures = import_module(experiment.measures)
    names: dict[str, None] = {}
    for trial in sorted(trials, key=lambda trial: trial.id):
        names.update(dict.fromkeys(trial.factors))
    left = [trial for trial in trials if trial.id not in done]
    roles = {
        role: device
        for role, field in type(profile.behavior).model_fields.items()
        if "device" in referred(field) and isinstance(device := getattr(profile.behavior, role), str)
    }
    return CampaignPlan(
        manifest={
            "profile": {
                "name": profile.name,
                "hash": profile.hash,
                "resolved": profile.resolved,
                "asked": dict(asked or {}),
                "own": own_modules(profile),
            },
            "experiment": profile.experiment,
            "seed": seed,
            "roles": roles,
            "successes": experiment.successes,
        },
        left=left,
        trials=_trial_plans(profile, left, seed),
        factors=tuple(names),
        columns=tuple(measures.COLUMNS),
        leading=getattr(measures, "HIGHLIGHTS", ()),
        loop=profile.loop,  # type: ignore[arg-type]
        signals={signal.info.name: signal.info for signal in make_signals(profile)},
        devices=devices,
    )


def own_modules(profile: Profile) -> Mapping[str, Mapping[str, str]]:
    """Folder and SHA-256 of each module of the user's own that a profile names."""
    chosen = [*profile.devices.values(), *profile.signals.values(), *profile.detectors.values()]
    chosen += [profile.plant] if profile.plant else []
    return own_files([profile.experiment, *(entry.kind for entry in chosen)])


def own_kinds(profile: Profile, there: Collection[str]) -> dict[str, Any]:
    """What `controller.contracts.tried` takes of a profile and its bench, which has the devices that are there; nothing
    where all is shipped."""
    devices = [name for name, entry in profile.devices.items() if is_own(entry.kind) and name in there]
    detectors, own_signals = (
        {
            name: partial(entry.made, name, entry.settings)
            for name, entry in named.items()
            if is_own(entry.kind)
        }
        for named in (profile.detectors, profile.signals)
    )
    if not (devices or detectors or own_signals):
        return {}
    baselines_s = {
        name: max((getattr(settings, key) for key in settings.keys_of("baseline")), default=0.0)
        for name in detectors
        for settings in [profile.detectors[name].settings]
    }
    signals = {signal.info.name: signal.info for signal in make_signals(profile)}
    return {
        "devices": devices,
        "detectors": detectors,
        "baselines_s": baselines_s,
        "own_signals": own_signals,
        "signals": signals,
    }


def _trial_plans(profile: Profile, trials: Sequence[Trial], seed: int) -> Iterator[TrialPlan]:
    measure = _measure_of(profile.experiment)
    for trial in trials:
        own = profile.for_trial(trial)
        behavior = _behavior(own, trial)
        needs = needs_of(own, behavior)
        armed = needs.named("detectors")
        yield TrialPlan(
            trial=trial.id,
            factors=trial.factors,
            scene=scene_of(own, trial, seed),
            behavior=behavior,
            detectors={name: each for name, each in make_detectors(own).items() if name in armed},
            guard=Guard(within(limits_of(own), needs), 1.0 / profile.loop.rate_hz),  # type: ignore[attr-defined]
            signals=make_signals(own),
            measure=lambda evidence, outcome, own=own: measure(evidence, own.behavior, outcome),  # type: ignore[misc]
        )


def _measure_of(experiment: str) -> Callable[..., Any]:
    """What measures a trial; of the user's own it is held against what its module declares."""
    kind = experiment_of(experiment)
    module = import_module(kind.measures)
    if not is_own(experiment):
        return found(f"{kind.measures}:measure")  # type: ignore[no-any-return]
    words = None if kind.outcomes is None else (*kind.outcomes, *UNMEASURED)

    def measure(*given: Any) -> Any:
        match returned := module.measure(*given):
            case (str(outcome), dict(row)) if words is None or outcome in words:
                if not (unknown := ", ".join(map(str, row.keys() - {*module.COLUMNS}))):
                    return outcome, row
                line = f"measure gives {unknown}, of which COLUMNS has nothing: {', '.join(module.COLUMNS)}"
            case (str(outcome), dict()) if words is not None:
                line = f"measure gives the outcome {outcome!r}, which OUTCOMES does not declare: {', '.join(words)}"
            case _:
                line = f"measure returned {returned!r}; return the outcome, a word, and a dict of the columns"
        raise KindError(f"{module.__file__}: {line}")

    return measure


def scene_of(profile: Profile, trial: Trial | None = None, seed: int = 0) -> TrialScene:
    """What a simulated bench is given before a trial, whose factors are laid over the profile; None is no trial's."""
    plant = profile.plant.settings.model_dump(mode="json") if profile.plant else {}
    return (
        TrialScene(0, seed, {}, plant) if trial is None else TrialScene(trial.id, seed, trial.factors, plant)
    )


def limits_of(profile: Profile) -> GuardSettings:
    """The guard's settings; on a bench without noise a stuck sensor cannot be detected, and a simulated bench may know
    how stiff a contact is. A limit that the lab has to give and has not given is none: nothing moves before, and what
    only listens holds nothing against the parent's value."""
    given: GuardSettings = profile.limits  # type: ignore[assignment]
    limits = given.without([path[1] for path in profile.source.unset if path[0] == "limits"])
    if profile.plant is None:
        return limits
    quiet = getattr(profile.plant.settings, "quiet", False)
    known_n_m = getattr(profile.plant.settings, "stiffest_n_m", None)
    changed: dict[str, Any] = {"stuck_s": None} if quiet else {}
    return limits.model_copy(update=changed | {"stiffness_n_m": limits.stiffness_n_m or known_n_m})


def _behavior(profile: Profile, trial: Trial) -> Behavior:
    """A trial's behavior, fresh.

    Args:
        profile: With the trial's factors laid over it.

    Raises:
        ProfileError: what it needs is not there.
    """
    made = found(experiment_of(profile.experiment).made)
    try:
        behavior: Behavior = made(profile.behavior, profile.factors_of(trial), frozenset(profile.detectors))
        behavior.check_plans()
    except ValueError as error:
        raise ProfileError(f"{profile.name}: trial {trial.id}: [behavior] {error}") from None
    armed = {name for plans in behavior.foreseen.values() for plan in plans for name in plan.detectors}
    for name in sorted(armed - profile.detectors.keys()):
        line = f"{profile.name}: trial {trial.id}: {profile.experiment} listens to a detector '{name}'"
        if name in profile.source.absent.get("detectors", ()):
            raise ProfileError(f'{line}, which is "none"; put it back, or leave this trial out')
        hint = near_or_all(name, profile.detectors)
        raise ProfileError(f"{line}, which has no [detectors.{name}]; {hint}")
    return behavior


def used_by(profile: Profile, trials: Sequence[Trial]) -> Sequence[tuple[Profile, Trial, Needs]]:
    """What each trial uses, repetitions aside, with its factors laid over the profile.

    Raises:
        ProfileError: a trial that its behavior cannot run, or a detector that it arms and the profile has not.
    """
    own = [(profile.for_trial(trial), trial) for trial in distinct(trials)]
    return [(varied, trial, needs_of(varied, _behavior(varied, trial))) for varied, trial in own]


def _used_devices(profile: Profile, trials: Sequence[Trial]) -> frozenset[str]:
    """What some trials open, if all is there that they use."""
    used = used_by(profile, trials)
    refuse_missing(used)
    devices = frozenset[str]().union(*(needs.devices for _, _, needs in used)) & profile.devices.keys()
    for number, fault in enumerate(profile.faults, start=1):
        if fault.device in profile.devices and fault.device not in devices:
            raise ProfileError(
                f'{profile.name}: [faults] #{number} device = "{fault.device}": none of the chosen trials uses it,'
                " so it is not opened and cannot fail; remove the fault, or choose other trials"
            )
    return devices


def make_signals(profile: Profile) -> Sequence[Signal]:
    """The profile's signals, fresh."""
    return [entry.make("signal", name) for name, entry in profile.signals.items()]


def make_detectors(profile: Profile) -> dict[str, Detector]:
    """The profile's detectors, fresh, by name."""
    return {name: entry.make("detector", name) for name, entry in profile.detectors.items()}


def make_detector(
    kind: str,
    overrides: Mapping[str, str],
    baseline: tuple[float, float] | None = None,
    folders: Sequence[Path] = (),
) -> Detector:
    """One detector by itself, for a recording.

    Args:
        kind: As `run.py list --detectors` shows it.
        overrides: Its settings, as TOML values.
        baseline: Times in seconds between which a detector with a baseline shall learn it.
        folders: Where a kind of the user's own is looked for.

    Raises:
        ProfileError: no such kind, or settings that it does not take.
    """
    if not is_own(kind) and kind not in KINDS["detector"]:
        raise ProfileError(f"--detector {kind}: no such detector; {near_or_all(kind, KINDS['detector'])}")
    try:
        made, model, _ = find("detector", kind, folders)
    except KindError as error:
        raise ProfileError(f"--detector {kind}: {error}") from None
    given = {key: given_value(f"--set {key}", text) for key, text in overrides.items()}
    if baseline is not None:
        given |= dict.fromkeys(model.keys_of("baseline"), baseline[1] - baseline[0])
    settings = validated(model, given, lambda place: f"--set {'.'.join(place)}")
    detector: Detector = made(kind, settings)
    return detector
