"""Verbs without an experiment: `monitor`, `jog`, `home`, `tare`."""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import click

from config import verbs
from config.assemble import build_rig, limits_of, make_signals, scene_of
from config.hints import near_or_all
from config.needs import Needs, may_move, refuse_missing, with_limits
from config.parts import parts_of
from config.profile import Profile
from config.source import ProfileError
from controller import by_hand
from controller.by_hand import HandResult, HandSession, sources
from controller.console import Console, EndingOperator, KeyOperator
from controller.guard import GuardSettings
from controller.holding import Holding, address, addresses
from controller.loop import HandOperator
from controller.rig import TrialScene
from controller.stopping import Stopping
from controller.subscriptions import missing
from drivers.core.axis import AxisLimits
from drivers.core.errors import DeviceError
from drivers.core.messages import Failed, Reached
from drivers.core.protocols import OwnZero

POSE_S = 2.0
"""How long an arm is given to tell its pose."""

CODES = {"done": verbs.DONE, "guard": verbs.GUARD, "fault": verbs.DEVICE, "interrupted": verbs.INTERRUPTED}


bench_options = verbs.options(click.argument("profile"), verbs.set_option, verbs.endpoints_option)
"""A PROFILE, other values for its settings, and the emulator to join."""


def loaded_bench(name: str, overrides: Mapping[str, str]) -> Profile:
    """A profile with one bench.

    Raises:
        click.UsageError: it has parts.
    """
    if parts := parts_of(name):
        first = next(iter(parts.tried))[0]
        raise click.UsageError(f"{name} has parts, each with a bench of its own: name one, such as {first}")
    return verbs.loaded_profile(name, overrides)


def session_on(
    loaded: Profile,
    devices: Collection[str],
    operator: HandOperator,
    endpoints: Mapping[str, Any] | None = None,
    *,
    moves: bool = False,
    doing: str = "",
    limits: GuardSettings | None = None,
    scene: TrialScene | None = None,
    **how: Any,
) -> HandSession:
    """Some devices of a profile's bench, for what a person asks for; still closed.

    Args:
        moves: As `build_rig`.
        doing: The verb, for the note by which `stop` finds this program; "" leaves none.
        limits: Other than the profile's.
        scene: For a simulated bench, other than an empty one.

    Raises:
        ProfileError: a value is missing that the lab has to give.
    """
    rig = build_rig(loaded, endpoints, devices=devices, moves=moves)
    return HandSession(
        rig,
        limits or limits_of(loaded),
        operator,
        loaded.loop,  # type: ignore[arg-type]
        lambda: make_signals(loaded),
        scene or scene_of(loaded),
        holding=Holding(loaded.name, doing, addresses(rig), loaded.bench == "hardware") if doing else None,
        **how,
    )


def ready(loaded: Profile) -> Sequence[str]:
    """The devices whose values are all given; of the others the line that says what is missing is printed."""
    found = []
    for name in loaded.devices:
        try:
            refuse_missing([(loaded, None, Needs.of_devices([name]))])
        except ProfileError as error:
            verbs.complain(f"{name} is left out: {error.problems[0]}")
        else:
            found.append(name)
    return found


def started_here(
    loaded: Profile, arm: str, overrides: Mapping[str, str], endpoints: Mapping[str, Any] | None
) -> Profile:
    """The profile, with the pose in which an arm stands now for the start pose that the lab does not know yet."""
    key = ("devices", arm, "start_pose")
    if key not in loaded.deferred:
        return loaded
    excused = replace(loaded, excused=frozenset([key]))
    with KeyOperator() as operator:
        with session_on(excused, [arm], operator, endpoints, moves=True) as session:
            for t_s, _ in session.listen([f"{arm}.pose"]):
                if len(session.latest.values(f"{arm}.pose")) or t_s > POSE_S:
                    break
        if operator.stopped:
            raise KeyboardInterrupt
    if not len(poses := session.latest.values(f"{arm}.pose")):
        raise click.UsageError(f"{arm} tells no pose; give it start_pose")
    verbs.say(f"{arm}: start_pose is not set; limits count from where it stands now")
    return loaded_bench(loaded.name, {**overrides, ".".join(key): str(poses[-1].tolist())})


def known_device(loaded: Profile, name: str) -> str:
    """The name of a device, if the profile has it.

    Raises:
        click.UsageError: it does not.
    """
    if name not in loaded.devices:
        raise click.UsageError(f"{loaded.name} has no device {name}; {near_or_all(name, loaded.devices)}")
    return name


def needed(loaded: Profile, mover: str) -> frozenset[str]:
    """The devices without which a mover may not move: itself, and those that its limits' streams come from."""
    own = replace(loaded, limits=by_hand.limits_of(loaded.limits, mover))  # type: ignore[arg-type]
    return with_limits(own, [("devices", mover)]).devices


def moving(loaded: Profile) -> Sequence[str]:
    """The devices of a profile that may move; what they are tells the device itself."""
    return [name for name, entry in loaded.devices.items() if may_move(entry)]


def ended(result: HandResult) -> int:
    """Print why it did not go as asked; the exit code."""
    if result.outcome != "done":
        verbs.complain(result.reason or f"{result.outcome}: the bench is still")
    return CODES.get(result.outcome, verbs.FAILED)


@click.command(cls=verbs.Verb)
@bench_options
@click.argument("device", required=False)
def home(
    profile: str, overrides: Mapping[str, str], device: str | None, endpoints: Mapping[str, Any] | None
) -> int:
    """Send each mover of a PROFILE home, or DEVICE alone, one after the other, under the guard.

    A stage goes to its home sensor, an arm in a straight line to start_pose, a gripper calibrates where it has not
    since it was switched on: its jaws must be empty. Only the mover is opened, and what its limits need.

    \b
    Example:
      run.py home hardware/transient
      run.py home hardware/slip arm

    Exit codes: 0 at home, 2 usage or profile, 3 device, 4 the guard stopped or refused it, 130 interrupted.
    """
    loaded, found = loaded_bench(profile, overrides), False
    with EndingOperator() as operator:  # one for all: what is pressed between two movers counts
        for mover in [known_device(loaded, device)] if device else moving(loaded):
            devices = needed(loaded, mover)
            with session_on(loaded, devices, operator, endpoints, moves=True, doing="home") as session:
                if mover not in session.movers:
                    if device:
                        raise click.UsageError(f"{mover} has no home: it does not move by itself")
                    continue
                verbs.say(f"{mover}: going home")
                result = by_hand.home(session, mover, by_hand.HOME_S)
                if code := ended(result):
                    return code
                found = True
                at_m = next(each.position_m for each in reversed(result.events) if isinstance(each, Reached))
                verbs.say(f"{mover}: stands at home, at {at_m * 1e3:.3f} mm")
            if operator.stopped:
                raise KeyboardInterrupt
    if not found:
        raise click.UsageError(f"{loaded.name} has nothing that moves")
    return verbs.DONE


@click.command(cls=verbs.Verb)
@bench_options
@click.argument("device", required=False)
def tare(
    profile: str, overrides: Mapping[str, str], device: str | None, endpoints: Mapping[str, Any] | None
) -> int:
    """Take the present level of each force sensor of a PROFILE for zero, or of DEVICE alone; nothing moves.

    Where the device itself does not keep its zero, the line for the profile that does is printed.

    \b
    Example:
      run.py tare hardware/transient
      run.py tare hardware/slip arm
    """
    loaded = loaded_bench(profile, overrides)
    asked = [known_device(loaded, device)] if device else list(loaded.devices)
    codes = []
    with (
        EndingOperator() as operator,
        session_on(loaded, asked, operator, endpoints, doing="tare") as session,
    ):
        forces = by_hand.forces(session.infos)
        if not forces:
            raise click.UsageError(f"{', '.join(asked)}: no stream in {' or '.join(by_hand.FORCES)} to tare")
        for stream in forces:
            result, levels = by_hand.tare(session, stream.name)
            codes.append(ended(result))
            if result.outcome == "done":
                before, after = (" ".join(f"{value:.4g}" for value in level) for level in levels)
                kept = ""
                if isinstance(owner := session.rig.devices[stream.name.partition(".")[0]], OwnZero):
                    setting = owner.zero_setting(stream.name) or "no setting does"
                    kept = f"; this zero is lost as the program ends; to keep it: {setting}"
                verbs.say(f"{stream.name}: {before} {stream.unit} is zero now; it reads {after}{kept}")
    return max(codes)


@click.command(cls=verbs.Verb)
@bench_options
@click.argument("streams", nargs=-1)
@click.option("--seconds", type=verbs.Finite(min=0.1, max=1e6), metavar="N", help="End after N seconds.")
def monitor(
    profile: str,
    overrides: Mapping[str, str],
    streams: Sequence[str],
    seconds: float | None,
    endpoints: Mapping[str, Any] | None,
) -> int:
    """Show the streams of a PROFILE's bench, or these STREAMS alone: value, rate, age, noise, loss, margin to a limit.

    Noise is the standard deviation of the last second, of the noisiest channel. Nothing moves, and only what is shown
    is opened and subscribed to; without STREAMS, devices that do not open are named and left out. q or Ctrl+C ends.
    Where the output is no terminal, the values are printed every second.

    \b
    Example:
      run.py monitor hardware/transient
      run.py monitor hardware/slip arm.force --seconds 10
    """
    from controller.hand_view import HandScreen, table
    from controller.jogging import ENDING

    loaded = loaded_bench(profile, overrides)
    made = {signal.info.name: signal for signal in make_signals(loaded)}
    devices = [known_device(loaded, name) for name in sources(streams, made)] or ready(loaded)
    absent: dict[str, DeviceError] | None = None if streams else {}
    with (
        KeyOperator() as operator,
        session_on(
            loaded, devices, operator, endpoints, paced=True, absent=absent, doing="monitor"
        ) as session,
    ):
        for error in (absent or {}).values():
            verbs.complain(str(error))
        if not session.infos:
            return verbs.DEVICE
        for stream in streams:
            if stream not in session.streams:
                raise click.UsageError(missing(stream, session.streams.keys()))
        shown = list(streams or session.streams)
        t_s, failed = 0.0, None
        with HandScreen(verbs.terminal(), verbs.say_at_once, lambda: table(session, shown, t_s)) as screen:
            for t_s, statuses in session.listen(shown):
                if failed := next((each for each in statuses if isinstance(each, Failed)), None):
                    break
                screen.show(t_s)
                if (seconds is not None and t_s >= seconds) or any(
                    key in ENDING for key in operator.pressed()
                ):
                    break
    if failed is not None:
        verbs.complain(f"{failed.device}: {failed.reason}")
    return verbs.DONE if failed is None else verbs.DEVICE


@click.command(cls=verbs.Verb)
@bench_options
@click.argument("device")
def jog(profile: str, overrides: Mapping[str, str], device: str, endpoints: Mapping[str, Any] | None) -> int:
    """Move DEVICE of a PROFILE's bench while a key is held, under the guard and the profile's limits.

    Slow first, 2 mm/s; with Shift 10 mm/s. A motion stops 0.2 s after its last key, at any other key, at Ctrl+C and
    when the terminal is lost. At the end the place where it stands is printed, as the line for the profile. A stage
    or gripper that does not know where it is goes home first: hold h.

    \b
    Keys:
      f b, or → ←         forward, back along the approach axis
      d a, w s, e c       an arm's tool along its own +x −x, +y −y, +z −z
      o c                 open, close a gripper
      h                   home, at its own speed, while it is held
      g                   a UR arm can be led by hand, until the next key
      q, Esc              end

    \b
    Example:
      run.py jog hardware/transient stage
      run.py jog hardware/slip arm --set limits.force_n=5

    Exit codes: 0 done, 2 usage or profile, 3 device, 4 the guard stopped or refused it, 130 interrupted.
    """
    from controller.hand_view import HandScreen, jog_lines
    from controller.jogging import Jog, motions

    loaded = loaded_bench(profile, overrides)
    if not (sys.stdin and sys.stdin.isatty()):
        raise click.UsageError("it moves by keys: call it on a terminal")
    loaded = started_here(loaded, known_device(loaded, device), overrides, endpoints)
    limits = by_hand.limits_of(limits_of(loaded), device)
    devices = needed(loaded, device)
    with (
        KeyOperator() as operator,
        session_on(loaded, devices, operator, endpoints, moves=True, paced=True, doing="jog") as session,
    ):
        settings = loaded.devices[device].settings
        axis = settings if isinstance(settings, AxisLimits) else None
        keys, refused = motions(session, device, limits, axis)
        if not keys:
            raise click.UsageError(
                "; ".join(refused) or f"{device} does not move: it has no position and no width"
            )
        doing = ""

        def lines() -> Sequence[str]:
            return jog_lines(session, device, limits, keys, refused, doing)

        def show(what: str) -> None:
            nonlocal doing
            doing = what
            screen.show(0.0)

        own = [stream for stream in session.infos[device].streams if stream != f"{device}.force"]
        with HandScreen(verbs.terminal(), lambda line: None, lines) as screen:
            result = session.run(Jog(device, keys, operator.pressed, show), device, own, limits=limits)
            doing = result.outcome
        code = ended(result)
        if stands := by_hand.place(session, device):
            verbs.say(stands)
    return code


@click.command(cls=verbs.Verb)
@bench_options
def stop(profile: str, overrides: Mapping[str, str], endpoints: Mapping[str, Any] | None) -> int:
    """Stop every mover of a PROFILE's bench, and say of each whether it stands still.

    A program that has the bench is asked to stop, as by `kill`: it stops every mover and ends. Then each mover is
    opened and stopped from here as well. A UR arm whose program hangs is stopped over its controller's dashboard.
    This is not the emergency stop.

    \b
    Example:
      run.py stop hardware/transient

    Exit codes: 0 every mover stands still, 3 one does not, or it is not known.
    """
    loaded = loaded_bench(profile, overrides)
    needless = frozenset(path for path in loaded.deferred if path[-1] in STOP_EXCUSES)
    loaded = replace(loaded, excused=needless)
    movers = [name for name in ready(loaded) if name in moving(loaded)]
    missing = [name for name in moving(loaded) if name not in movers]
    if not moving(loaded):
        verbs.say(f"{loaded.name} has nothing that moves")

    def open_one(name: str) -> HandSession:
        return session_on(loaded, [name], Console(), endpoints)

    where = {name: dict(each) for name, each in (endpoints or {}).get("devices", {}).items()}
    for name in movers:
        entry = loaded.devices[name]
        if entry.port not in ("mock", "emulated"):
            where[name] = dict(address(entry.settings))
    settings = {name: loaded.devices[name] for name in movers}
    gone = loaded.bench == "mock" or (loaded.bench == "emulated" and endpoints is None)
    stopping = Stopping(
        "" if endpoints else loaded.name, where, settings, verbs.say, None if gone else open_one
    )
    return verbs.DONE if stopping.run() and not missing else verbs.DEVICE


STOP_EXCUSES = ("start_pose", "approach_axis", "tcp_offset", "payload_kg", "payload_cog_m")
"""Settings of an arm that a stop needs no value of."""
