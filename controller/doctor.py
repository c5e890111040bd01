"""A bench looked at without moving it: the computer, every device opened, every sensor read for a moment."""

import os
import resource
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Literal, NamedTuple

import numpy as np

from behaviors.events import BaselineRefused
from controller.campaign import TrialPlan
from controller.detectors.contract import ALARMS
from controller.guard import GuardRefusal
from controller.limits import shown_limits
from controller.rig import Rig, TrialScene, opened, streams_of
from controller.signals.protocol import Signal, Signals
from controller.subscriptions import missing, unknown_streams
from drivers.core.errors import DeviceError
from drivers.core.messages import (
    DeviceInfo,
    Failed,
    Listen,
    Lost,
    Refused,
    SampleBlock,
    Stalled,
    Status,
    StreamInfo,
)

ASK = "to ask who is there: --ports, which resets many a board"

LISTEN_S = 1.0
"""How long each sensor is read. Assumption: enough for every regular stream, short enough to be waited for."""

TURN_S = 0.01
"""How often what has come is taken; at 1 kHz that is ten samples."""

LATE_S = 0.02
"""By how much a turn may come late: a fifth of what the guard tolerates by default."""

DRIFT, DRIFT_SAMPLES = 1.0, 20
"""Means of two halves that are farther apart than the noise's standard deviation are drift, of so many samples each."""

SHOWN = 8
"""Channels of a stream that are shown."""

RATE = 0.02
"""How far a rate may be from what the device says (assumption: some blocks at the ends of the second)."""

LOST = 0.05
"""Share of samples that may be lost in this second with no more than a warning."""


Verdict = Literal["ok", "warn", "fail"]


class Finding(NamedTuple):
    """One line about the bench, with the remedy where it is not good; and whether the profile is what to mend."""

    verdict: Verdict
    line: str
    of_profile: bool = False


def summary(findings: Sequence[Finding]) -> str:
    """How many of each."""
    counts = Counter(finding.verdict for finding in findings)
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in ("ok", "warn", "fail"))


def compare(
    rig: Rig, trials: Iterable[TrialPlan], named: Sequence[tuple[str, str]] = ()
) -> Iterator[Finding]:
    """Open every device and close it again: a line for each stream that is named or needed and no device sends.

    Args:
        rig: The bench, closed.
        trials: Whose streams are looked for, and their guards'.
        named: Other streams: where each is named, and its name.

    Raises:
        DeviceError: one does not open.
    """
    try:
        infos = {name: opened(name, device) for name, device in rig.devices.items()}
        yield from _unknown_streams(infos, trials, named)
    finally:
        for device in rig.devices.values():
            device.close()


def examine(
    rig: Rig,
    scene: TrialScene,
    trials: Iterable[TrialPlan] = (),
    named: Sequence[tuple[str, str]] = (),
    ports: Mapping[str, str] | None = None,
    watchdogs: Mapping[str, float] | None = None,
    ask: bool = False,
) -> Iterator[Finding]:
    """Look at the computer, open every device, read each of its streams for a second, close all; nothing is moved or
    excited.

    A device that does not open is reported, and the others are examined all the same.

    Args:
        rig: The bench, closed.
        scene: For a simulated bench: the scene that it is to be in.
        trials: As `compare`; looked at where every device opens.
        named: Likewise.
        ports: Of a real bench: where each device is.
        watchdogs: Devices whose own watchdog switches their streams off, and after how long without the host.
        ask: Whether the ports that the profile does not use are asked who is there.
    """
    infos: dict[str, DeviceInfo] = {}
    trials = list(trials)
    if rig.kind == "hardware" or ask:
        yield from computer(ports or {}, ask)
    try:
        for name, device in rig.devices.items():
            try:
                infos[name] = opened(name, device)
            except DeviceError as error:
                yield Finding("fail", str(error))
        blocks, statuses, late_s = _listen(rig, scene, infos)
        rate = RATE + max(late_s, default=0.0) / LISTEN_S  # what arrives late is dated late
        if rig.time == "wall":
            yield _punctual(late_s)
        for name, info in infos.items():
            yield _identity(name, info)
            yield from _state(name, info)
            own = [status for status in statuses if status.device == name]
            for stream in info.streams.values():
                lost = sum(s.samples for s in own if isinstance(s, Lost) and s.stream == stream.name)
                yield from _reading(stream, blocks.get(stream.name, []), rate, lost)
            yield from _troubles(own, {key: sum(map(len, got)) for key, got in blocks.items()})
            if warning := rig.devices[name].account().get("warning"):
                yield Finding("warn", f"    {warning}")
        whole = infos.keys() == rig.devices.keys()
        unknown = list(_unknown_streams(infos, trials, named)) if whole else []
        yield from unknown
        for name in (watchdogs or {}).keys() & infos.keys():
            yield _watchdog(rig, infos[name], (watchdogs or {})[name])
        if trials and whole and not unknown:
            yield from _uses(trials[0], blocks)  # last: devices are left alone while it computes
    finally:
        for device in rig.devices.values():
            device.close()


# --- the computer ------------------------------------------------------------------------------------


def computer(ports: Mapping[str, str], ask: bool = False) -> Iterator[Finding]:
    """The serial ports and CAN interfaces that are there, whether this user may open them, and the right to run in
    real time.

    Args:
        ports: Where each device of the bench is.
        ask: Whether the other ports are asked who is there, and CAN interfaces looked for.
    """
    from serial.tools.list_ports import comports

    from controller.who_answers import can_interfaces, who_answers

    used = {os.path.realpath(port): name for name, port in ports.items()}
    found = {port.device: port for port in comports()}
    names = {device: used.get(os.path.realpath(device), "") for device in found}
    may = {device for device in found if os.access(device, os.R_OK | os.W_OK)}
    others = [device for device, name in names.items() if device in may and not name]
    answers = dict(zip(others, who_answers(others) if ask else [ASK] * len(others), strict=True))
    for device, port in found.items():
        name = names[device]
        what = ", ".join(str(part) for part in (port.manufacturer, port.product) if part) or port.description
        line = f"{device} ({what}): {f'{name} of this profile' if name else 'not used by this profile'}"
        if device in may:
            yield Finding("ok", line if name else f"{line}; {answers[device]}")
            continue
        remedy = "sudo usermod -aG dialout $USER, then log in again"
        if port.vid is not None and port.pid is not None:
            of = f'ATTRS{{idVendor}}=="{port.vid:04x}", ATTRS{{idProduct}}=="{port.pid:04x}"'
            remedy += f'; or a udev rule: SUBSYSTEM=="tty", {of}, GROUP="dialout", MODE="0660"'
        yield Finding("fail" if name else "warn", f"{line}; this user may not open it: {remedy}")
    yield from (Finding("ok", f"CAN: {each}") for each in (can_interfaces() if ask else ()))
    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    if limit == 0 and os.geteuid() != 0:
        remedy = "add '@dialout - rtprio 20' to /etc/security/limits.d/bench.conf, then log in again"
        yield Finding("warn", f"no right to run in real time, which an arm's process asks for: {remedy}")
    else:
        yield Finding("ok", "may run in real time")


def _punctual(late_s: Sequence[float]) -> Finding:
    """How late this program woke up while it listened."""
    worst_s = max(late_s, default=0.0)
    line = f"this program woke at most {1e3 * worst_s:.1f} ms late in {len(late_s)} turns"
    remedy = "end what else runs here, and switch the processor's power saving off"
    return Finding("ok", line) if worst_s <= LATE_S else Finding("warn", f"{line}; {remedy}")


def _unknown_streams(
    infos: Mapping[str, DeviceInfo], trials: Iterable[TrialPlan], named: Sequence[tuple[str, str]]
) -> Iterator[Finding]:
    streams = streams_of(infos)
    lines = [f"{where} = {missing(name, streams.keys())}" for where, name in named if name not in streams]
    if not lines:  # each of these would be reported once more
        for trial in trials:
            lines += unknown_streams(streams.keys(), trial.behavior, trial.detectors, trial.signals)
            made = {signal.info.name: signal.info for signal in trial.signals}
            try:
                trial.guard.check_streams(streams | made)
            except GuardRefusal as refusal:
                lines.append(str(refusal))
    yield from (Finding("fail", line, of_profile=True) for line in dict.fromkeys(lines))


def _listen(
    rig: Rig, scene: TrialScene, infos: dict[str, DeviceInfo]
) -> tuple[dict[str, list[SampleBlock]], list[Status], list[float]]:
    """What the bench sends in a second: blocks by stream, and statuses; and how late each look at it was."""
    blocks: dict[str, list[SampleBlock]] = {}
    statuses: list[Status] = []
    late_s: list[float] = []
    rig.clock.restart()
    rig.begin_trial(scene)
    for name, info in infos.items():
        rig.devices[name].apply(Listen(name, frozenset(info.streams)))
    while (now_s := rig.clock.now()) < LISTEN_S:
        rig.clock.wait_until(now_s + TURN_S)
        late_s.append(rig.clock.now() - now_s - TURN_S)
        for name in infos:
            for block in rig.devices[name].read():
                blocks.setdefault(block.stream, []).append(block)
            statuses += rig.devices[name].poll()
    for name in infos:
        rig.devices[name].apply(Listen(name, frozenset()))
    return blocks, statuses, late_s


# --- the devices -------------------------------------------------------------------------------------


def _identity(name: str, info: DeviceInfo) -> Finding:
    known = [info.model, info.serial and f"serial {info.serial}", info.version and f"version {info.version}"]
    details = [f"{key} {said}" for key, value in info.details.items() if (said := _shown(value))]
    return Finding("ok", f"{name}: {', '.join(part for part in [*known, *details] if part)}")


SOUND = {
    "robot_mode": ("RUNNING", "switch it on and release its brakes at the pendant"),
    "safety_status": ("NORMAL", "look at the arm, then clear the stop at the pendant"),
    "remote_control": ("true", "switch remote control on at the pendant"),
    "speed_slider": ("1", "it is slower than the profile says: move the slider at the pendant to 100 %"),
    "realtime": ("True", "its process runs without real-time priority: see the right to run in real time"),
    "not_stated_by_the_profile": ("", "give them: what the controller counts with is compared with nothing"),
}
"""What a device may say of itself, how that should be, and what to do where it is not."""


def _shown(value: object) -> str:
    """What a device says, for a person."""
    if isinstance(value, tuple | list):
        return " ".join(_shown(each) for each in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _state(name: str, info: DeviceInfo) -> Iterator[Finding]:
    """What a device says of itself and should not."""
    for key, (sound, remedy) in SOUND.items():
        shown = _shown(info.details.get(key, sound))
        if shown != sound:
            yield Finding("warn", f"    {name}: {key} is {shown}; {remedy}")


def _reading(stream: StreamInfo, blocks: Sequence[SampleBlock], rate: float, lost: int) -> Iterator[Finding]:
    """What a stream's samples are: how many, mean and noise, how far they drift, at which rate they were sent."""

    def found(verdict: Verdict, text: str) -> Finding:
        return Finding(verdict, f"    {stream.name}: {text}")

    if not sum(map(len, blocks)):
        if stream.rate_hz is None:
            yield found("ok", f"nothing in {LISTEN_S:g} s; it sends when something happens")
        else:
            yield found("fail", f"silent for {LISTEN_S:g} s; is the sensor plugged in?")
        return
    values = np.concatenate([block.physical for block in blocks])
    if not np.isfinite(values).all():
        yield found("fail", "reads values that are not finite; is the sensor plugged in?")
        return
    means, spreads = values.mean(axis=0), values.std(axis=0)
    each = list(zip(stream.channels, means, spreads, strict=True))[:SHOWN]
    shown = ", ".join(f"{channel} {mean:.6g} +- {spread:.2g}" for channel, mean, spread in each)
    more = f", and {len(means) - SHOWN} more channels" * (len(means) > SHOWN)
    yield found("ok", f"{len(values)} samples in {LISTEN_S:g} s, {shown}{more} {stream.unit}".rstrip())
    if stream.noisy and not spreads.any():
        yield found("fail", "repeats one value; is the sensor plugged in?")
    half = len(values) // 2
    if half >= DRIFT_SAMPLES:
        drifts = np.abs(values[half:].mean(axis=0) - values[:half].mean(axis=0))
        if (drifts > DRIFT * spreads).any() and spreads.any():
            line = f"drifts by {drifts.max():.2g} {stream.unit} in {LISTEN_S / 2.0:g} s"
            yield found("warn", f"{line}; let it warm up, and let nothing move")
    times_s = np.concatenate([block.times for block in blocks])
    if stream.rate_hz is not None and len(times_s) > 1 and times_s[-1] > times_s[0]:
        rate_hz = (len(times_s) - 1 + lost) / (times_s[-1] - times_s[0])
        if abs(rate_hz / stream.rate_hz - 1.0) > rate:
            line = f"comes at {rate_hz:.4g} Hz, not at {stream.rate_hz:g}; correct its rate where it is set"
            yield found("warn", line)


def _troubles(statuses: Sequence[Status], read: Mapping[str, int]) -> Iterator[Finding]:
    """What went wrong while a device was read: one line for all of a kind, with their number."""
    losses = [status for status in statuses if isinstance(status, Lost)]
    failures = [status for status in statuses if isinstance(status, Failed | Refused | Stalled)]
    others = Counter(f"{type(status).__name__.lower()}: {status.reason}" for status in failures)
    for stream in dict.fromkeys(each.stream for each in losses):
        holes = [each.samples for each in losses if each.stream == stream]
        samples = sum(holes)
        few = samples <= LOST * (read.get(stream, 0) + samples)
        places = f" in {len(holes)} places" if len(holes) > 1 else ""
        remedy = "look at the cable, and at what else this computer does"
        yield Finding("warn" if few else "fail", f"    {stream}: {samples} samples lost{places}; {remedy}")
    for line, count in others.items():
        yield Finding("fail", f"    {line}" + (f" ({count} times)" if count > 1 else ""))


def _watchdog(rig: Rig, info: DeviceInfo, watchdog_s: float) -> Finding:
    """Leave a device alone for longer than its watchdog allows: it must have ceased to send by itself."""
    name, device = info.device, rig.devices[info.device]
    regular = frozenset(stream.name for stream in info.streams.values() if stream.rate_hz is not None)
    device.apply(Listen(name, regular))
    began_s, heard = rig.clock.now(), list[SampleBlock]()
    while not heard:
        if rig.clock.now() >= began_s + LISTEN_S:
            unheard = f"    {name}: its watchdog of {watchdog_s:g} s is not shown, as it sends nothing"
            return Finding("warn", f"{unheard}; is the sensor plugged in?")
        rig.clock.wait_until(rig.clock.now() + TURN_S)
        heard += filter(len, device.read())
        device.poll()
    left_s = rig.clock.now()
    rig.clock.wait_until(left_s + watchdog_s + 1.0)
    heard += filter(len, device.read())
    device.poll()
    sent_s = max(0.0, max(block.last_s for block in heard) - left_s)
    line = f"    {name}: left alone for {watchdog_s + 1.0:g} s, it went on sending for {sent_s:.2f} s"
    if sent_s <= watchdog_s + 0.5:
        return Finding("ok", f"{line}: its watchdog of {watchdog_s:g} s acts")
    return Finding("fail", f"{line}: its watchdog of {watchdog_s:g} s does not act; look at its firmware")


# --- what the trials need of it ----------------------------------------------------------------------


def _with_signals(
    made: Sequence[Signal], blocks: Mapping[str, Sequence[SampleBlock]]
) -> tuple[Mapping[str, Sequence[SampleBlock]], str]:
    """What was read, and what the signals make of it; and why one cannot use its stream, or ""."""
    signals, found = Signals(made), {stream: list(got) for stream, got in blocks.items()}
    signals.subscribe(signals.streams)
    try:
        for block in signals.push(sorted(chain(*blocks.values()), key=lambda block: block.t0_s))[0]:
            found.setdefault(block.stream, []).append(block)
    except ValueError as error:
        return blocks, str(error)
    return found, ""


def _uses(trial: TrialPlan, blocks: Mapping[str, Sequence[SampleBlock]]) -> Iterator[Finding]:
    """Whether the signals, the guard's limits and the detectors can use what was read."""
    blocks, unfit = _with_signals(trial.signals, blocks)
    if unfit:
        yield Finding("fail", unfit, of_profile=True)
    limits = trial.guard.settings
    for what, stream, channels, limit, unit in shown_limits(limits):
        got = blocks.get(stream, ())
        if what != "force" or not got:
            continue
        values = np.concatenate([block.physical[:, channels] for block in got])
        if not np.isfinite(values).all():
            continue  # said of the stream
        size = float(np.linalg.norm(np.median(values, axis=0)))
        line = f"limits.force_n = {limit:g} {unit}: {stream} is at {size:.3g} {unit} at rest"
        if size > 0.5 * limit:
            yield Finding("fail" if size > limit else "warn", f"{line}; tare it, or look what presses")
        else:
            yield Finding("ok", line)
    for name, detector in trial.detectors.items():
        if absent := [stream for stream in detector.inputs if not blocks.get(stream)]:
            yield Finding("ok", f"detector {name}: not tried, as nothing came of {', '.join(absent)}")
            continue
        mixed = [block for stream in detector.inputs for block in blocks[stream]]
        mixed.sort(key=lambda block: block.t0_s)
        try:
            detector.reset()
            events = [event for block in mixed for event in detector.push(block)]
        except ValueError as error:
            yield Finding("fail", f"detector {name}: {error}", of_profile=True)
            continue
        refused = next((event for event in events if isinstance(event, BaselineRefused)), None)
        alarms = sum(type(event).__name__ in ALARMS for event in events)
        verdict: Verdict = "warn" if refused or alarms else "ok"
        if refused:
            text = f"refuses this second as its baseline: {refused.reason}"
        elif alarms:
            text = f"{alarms} alarms in this second at rest; its threshold lies in the noise: calibrate it"
        else:
            text = f"takes {', '.join(detector.inputs)}; no alarm in this second"
        yield Finding(verdict, f"detector {name}: {text}")
