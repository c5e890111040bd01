"""What `run.py check` tries of a user's own devices, signals and detectors: a line for each promise that is broken."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from controller.detectors.contract import CLAUSES, cut, trace
from controller.detectors.protocol import Detector
from controller.doctor import Finding
from controller.own_modules import own_place
from controller.rig import Rig, TrialScene, opened, streams_of
from controller.signals.protocol import Signal
from drivers.core.errors import CommandError
from drivers.core.messages import (
    DeviceInfo,
    Failed,
    Listen,
    Lost,
    MoveTo,
    SampleBlock,
    Stalled,
    StreamInfo,
)

TURN_S = 0.01
"""How often what has come is taken."""

LISTEN_S = 0.5
"""How long a device is listened to."""

RATE = 0.1
"""How far the samples that come meanwhile may be from as many as the rate says (assumption: a block is under way)."""

RESTS_S, TOUCHED_S = 1.0, 2.0
"""What a detector is shown: rest (and its baseline), then a step with an oscillation on it, then rest again."""

LONGEST_S = 30.0
"""Of a baseline that is shown (assumption: a longer one would keep a person waiting)."""

EVENTS_HZ = 28.0
"""How often samples come that have no rate: the finger's periods do."""

SEED = 1


def tried(
    rig: Rig,
    scene: TrialScene,
    devices: Sequence[str],
    detectors: Mapping[str, Callable[[], Detector]],
    baselines_s: Mapping[str, float],
    own_signals: Mapping[str, Callable[[], Signal]],
    signals: Mapping[str, StreamInfo],
) -> Iterator[Finding]:
    """Try a user's own devices, signals and detectors.

    Args:
        rig: The bench, closed; nothing is moved on it.
        scene: For a simulated bench: the scene that it is to be in.
        detectors: Likewise, and what makes each.
        baselines_s: For how long each of them learns.
        own_signals: Names of the signals to try, and what makes each.
    """
    infos: dict[str, DeviceInfo] = {}
    try:
        infos = {name: opened(name, device) for name, device in rig.devices.items()}
        rig.clock.restart()
        rig.begin_trial(scene)
        for name in devices:
            yield from _findings(f"devices.{name}", _device(rig, name, infos[name]))
    finally:
        for device in rig.devices.values():
            device.close()
    for name in devices:
        rig.devices[name].close()  # twice is no error
    streams = streams_of(infos) | dict(signals)
    for name, made in own_signals.items():
        yield from _findings(f"signals.{name}", _signal(name, made, streams))
    for name, make in detectors.items():
        yield from _findings(f"detectors.{name}", _detector(make, streams, baselines_s[name]))


class _UntriedError(Exception):
    """Why a promise could not be tried."""


def _findings(what: str, broken: Iterator[str | None]) -> Iterator[Finding]:
    """A line for each broken promise; a None among them is a promise kept."""
    kept, lines = 0, []
    try:
        for line in broken:
            kept += line is None
            lines += [line] if line else []
    except _UntriedError as error:
        yield Finding("ok", f"{what}: not tried: {error}")
        return
    except Exception as error:  # of the user's own, which is named
        place = own_place(error)
        lines.append(f"{type(error).__name__}: {error}" + (f" ({place})" if place else ""))
    yield from (Finding("fail", f"{what}: {line}", of_profile=True) for line in lines)
    if not lines:
        yield Finding("ok", f"{what}: keeps the contract ({kept} promises)")


def _device(rig: Rig, name: str, info: DeviceInfo) -> Iterator[str | None]:
    """What a device breaks of `Device`."""
    device = rig.devices[name]

    statuses: list[Any] = []

    def turn(seconds: float) -> list[SampleBlock]:
        blocks: list[Any] = []
        end_s = rig.clock.now() + seconds
        while rig.clock.now() < end_s:
            rig.clock.wait_until(rig.clock.now() + TURN_S)
            for member, given, kept in (("read", device.read(), blocks), ("poll", device.poll(), statuses)):
                if not isinstance(given, Iterable):
                    raise TypeError(f"{member}() returns {given!r}, not a list")
                kept.extend(given)
        return blocks

    def refusal(command: Any) -> str | None:
        try:
            device.apply(command)
        except CommandError as error:
            line = str(error)
            sound = line.startswith(f"{name}: ") and "\n" not in line
            return None if sound else f"refuses with {line!r}, not '{name}: …' in one line"
        except Exception as error:
            return f"{advised} {command}, not with {type(error).__name__}: {error}"
        return f"{advised} {command}, not taken"

    advised = "a CommandError (`wrong`, `check_streams`) is the answer to"
    yield None if info.device == name else f"its DeviceInfo is of {info.device!r}; give it self.name"
    for key, stream in info.streams.items():
        sound = key == stream.name and key.startswith(f"{name}.") and stream.unit and stream.scale > 0.0
        yield (
            None
            if sound
            else f"stream {key}: has a name '{name}.…', a unit and a scale above 0, not {stream}"
        )
    silent = not turn(0.1)
    yield None if silent else "sends samples that nobody listens to; wait for Listen"
    unknown = refusal(Listen(name, frozenset({f"{name}.no_such_stream"})))
    passed_over = unknown is not None and unknown.endswith("not taken") and not turn(0.1)
    yield None if passed_over else unknown
    yield refusal(MoveTo(name, math.nan, math.nan))
    device.apply(Listen(name, frozenset(info.streams)))
    blocks = turn(LISTEN_S)
    for key, stream in info.streams.items():
        yield _rate(stream, sum(len(block) for block in blocks if block.stream == key))
        yield _samples(stream, [block for block in blocks if block.stream == key])
    lost = Counter[str]()
    for each in statuses:
        lost.update({each.stream: each.samples} if isinstance(each, Lost) else {})
    told = ", ".join(f"{count} of {stream}" for stream, count in lost.items())
    yield (
        f"loses samples ({told}); are its rate, its time's unit, its counter's modulus right?"
        if lost
        else None
    )
    failed = [each.reason for each in statuses if isinstance(each, Failed | Stalled)]
    yield f"fails: {failed[0]}" if failed else None
    device.apply(Listen(name, frozenset()))
    turn(0.1)
    yield None if not turn(0.1) else "goes on sending when nobody listens any more"


def _rate(stream: StreamInfo, count: int) -> str | None:
    """What is wrong with how many samples came; that none came is told otherwise."""
    expected = (stream.rate_hz or 0.0) * LISTEN_S
    if not count or not expected or abs(count - expected) <= max(2.0, RATE * expected):
        return None
    return f"stream {stream.name}: {count} samples in {LISTEN_S:g} s, not {expected:.0f} as its rate_hz says"


def _samples(stream: StreamInfo, blocks: Sequence[SampleBlock]) -> str | None:
    """What is wrong with the blocks of a stream."""
    if not blocks:
        expected = (stream.rate_hz or 0.0) * LISTEN_S > 2
        return f"stream {stream.name}: no sample in {LISTEN_S:g} s" if expected else None
    for block in blocks:
        shape = block.values.shape
        if shape != (len(block), len(stream.channels)):
            return f"stream {stream.name}: values of shape {shape}, not (n, {len(stream.channels)})"
        if (block.unit, block.scale, block.rate_hz) != (stream.unit, stream.scale, stream.rate_hz):
            return f"stream {stream.name}: its blocks' unit, scale or rate is not its StreamInfo's; see info.block"
        if not np.isfinite(block.physical).all():
            return f"stream {stream.name}: reads values that are not finite"
    for before, after in pairwise(blocks):
        if after.seq < before.seq + len(before) or after.t0_s <= before.last_s:
            begins = f"a block begins at number {after.seq}, {after.t0_s:.4f} s"
            return f"stream {stream.name}: {begins}, within the one before"
    return None


SIZES = (7, 64)
"""Samples in a block, of signals."""

ROUNDING = 1e-9
"""How far a signal's values may differ where sums are made in another order, as a share of its largest."""


def _signal(name: str, make: Callable[[], Signal], streams: Mapping[str, StreamInfo]) -> Iterator[str | None]:
    """What a signal breaks of `Signal`."""
    signal = make()
    info = signal.info
    if unknown := [each for each in signal.inputs if each not in streams]:
        raise _UntriedError(f"nothing sends {', '.join(unknown)}")
    sound = info.name == f"signals.{name}" and info.unit and info.scale > 0.0
    yield (
        None if sound else f"its info is of {info.name!r}; give it 'signals.{name}', a unit, a scale above 0"
    )
    blocks = _shown([streams[each] for each in signal.inputs], 0.0)
    whole = _made(signal, blocks)
    if not any(map(len, whole)):
        raise _UntriedError(
            f"it makes nothing of a rest, a step and an oscillation on {', '.join(signal.inputs)}"
        )
    yield _samples(replace(info, rate_hz=whole[0].rate_hz), whole)  # a rate that follows the inputs
    last_s = max(block.last_s for block in blocks)
    late = [block.last_s for block in whole if block.last_s > last_s]
    yield f"has a sample at {late[0]:.6g} s, later than its inputs' last at {last_s:.6g} s" if late else None
    for size in SIZES:
        parts = sorted((part for block in blocks for part in cut(block, size)), key=lambda part: part.last_s)
        yield _differs(f"blocks of {size}", _made(make(), parts), whole)
    signal.reset()
    yield _differs("after a reset", _made(signal, blocks), whole)
    spoiled = [replace(block, values=np.full_like(block.physical, np.nan), scale=1.0) for block in blocks]
    finite = [block for block in _made(make(), spoiled) if np.isfinite(block.physical).any()]
    yield "makes values that are finite of samples that are all nan" if finite else None


def _made(signal: Signal, blocks: Sequence[SampleBlock]) -> list[SampleBlock]:
    """What a signal makes of blocks, without its statuses."""
    found = [each for block in blocks for each in signal.push(block)]
    return [each for each in found if isinstance(each, SampleBlock)]


def _differs(what: str, found: Sequence[SampleBlock], whole: Sequence[SampleBlock]) -> str | None:
    """How one way to give samples differs from another, which must give the same."""
    count, expected = sum(map(len, found)), sum(map(len, whole))
    if count != expected:
        return f"{what}: gives {count} samples, not {expected}"
    mine, theirs = (
        {
            "numbers": np.concatenate([each.seq + np.arange(len(each)) for each in blocks]),
            "times": np.concatenate([each.times for each in blocks]),
            "values": np.concatenate([each.physical for each in blocks]),
        }
        for blocks in (found, whole)
    )
    for kind, right in theirs.items():
        nearly = ROUNDING * float(np.nanmax(np.abs(right)))
        if not np.allclose(mine[kind], right, 0.0, nearly, equal_nan=True):
            return f"{what}: gives other {kind}, by up to {np.nanmax(np.abs(mine[kind] - right)):.3g}"
    return None


def _detector(
    make: Callable[[], Detector], streams: Mapping[str, StreamInfo], baseline_s: float
) -> Iterator[str | None]:
    """What a detector breaks of its contract."""
    inputs = make().inputs
    if unknown := [name for name in inputs if name not in streams]:
        raise _UntriedError(f"nothing sends {', '.join(unknown)}")
    blocks = _shown([streams[name] for name in inputs], min(baseline_s, LONGEST_S))
    if not trace(make(), blocks)[0]:
        shown = f"a rest, a step and an oscillation on {', '.join(inputs)}"
        raise _UntriedError(f"it finds nothing in {shown}; give check_contract samples of yours in a test")
    for clause in CLAUSES:
        try:
            clause(make, blocks)
            yield None
        except AssertionError as error:
            yield f"{clause.__name__.replace('_', ' ')}: broken. {_short(error)}"


def _short(error: AssertionError, longest: int = 200) -> str:
    text = " ".join(str(error).split())
    return text if len(text) <= longest else f"{text[:longest]} …"


def _shown(streams: Sequence[StreamInfo], baseline_s: float) -> list[SampleBlock]:
    """Samples of all inputs in which something happens, in blocks of 0.1 s, in the order of time."""
    rests_s = RESTS_S + 1.2 * baseline_s
    random = np.random.default_rng(SEED)
    blocks = []
    for stream in streams:
        hz = stream.rate_hz or EVENTS_HZ
        times_s = np.arange(math.ceil((rests_s + TOUCHED_S + RESTS_S) * hz)) / hz
        touched = (times_s > rests_s) & (times_s <= rests_s + TOUCHED_S)
        # in steps of the stream: large against its noise, small against any range
        counts = random.normal(0.0, 3.0, (len(times_s), len(stream.channels)))
        counts += (touched * (1e5 + 5e4 * np.sin(2.0 * np.pi * 0.11 * hz * times_s)))[:, None]
        counts = np.rint(counts)
        per_block = max(1, round(0.1 * hz))
        for start in range(0, len(times_s), per_block):
            part = slice(start, start + per_block)
            own_s = None if stream.rate_hz else times_s[part]
            shown = stream.block(start, float(times_s[start]), counts[part], times_s=own_s)
            blocks.append(shown.read_only())
    return sorted(blocks, key=lambda block: block.last_s)
