"""A bench looked at without moving it: every device opened, every sensor read for a moment."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from controller.campaign import TrialPlan
from controller.guard import GuardRefusal
from controller.rig import Rig, TrialScene
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

LISTEN_S = 1.0
"""How long each sensor is read. Assumption: enough for every regular stream, short enough to be waited for."""

TURN_S = 0.01
"""How often what has come is taken; at 1 kHz that is ten samples."""


class Finding(NamedTuple):
    """One line about the bench, whether it is good, and whether the profile is what to mend."""

    sound: bool
    line: str
    of_profile: bool = False


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
        yield from _unknown_streams(
            {name: device.open() for name, device in rig.devices.items()}, trials, named
        )
    finally:
        for device in rig.devices.values():
            device.close()


def examine(
    rig: Rig, scene: TrialScene, trials: Iterable[TrialPlan] = (), named: Sequence[tuple[str, str]] = ()
) -> Iterator[Finding]:
    """Open every device, read each of its streams for a second, close all; nothing is moved or excited.

    A device that does not open is reported, and the others are examined all the same.

    Args:
        rig: The bench, closed.
        scene: For a simulated bench: the scene that it is to be in.
        trials: As `compare`; looked at where every device opens.
        named: Likewise.
    """
    infos: dict[str, DeviceInfo] = {}
    try:
        for name, device in rig.devices.items():
            try:
                infos[name] = device.open()
            except DeviceError as error:
                yield Finding(False, str(error))
        blocks, statuses = _listen(rig, scene, infos)
        for name, info in infos.items():
            yield _identity(name, info)
            for stream in info.streams.values():
                yield _reading(stream, blocks.get(stream.name, []))
            for status in statuses:
                if status.device == name and isinstance(status, Failed | Lost | Refused | Stalled):
                    yield _trouble(status)
        if infos.keys() == rig.devices.keys():
            yield from _unknown_streams(infos, trials, named)
    finally:
        for device in rig.devices.values():
            device.close()


def _unknown_streams(
    infos: Mapping[str, DeviceInfo], trials: Iterable[TrialPlan], named: Sequence[tuple[str, str]]
) -> Iterator[Finding]:
    streams = {name: stream for info in infos.values() for name, stream in info.streams.items()}
    lines = [f"{where} = {missing(name, streams.keys())}" for where, name in named if name not in streams]
    if not lines:  # each of these would be reported once more
        for trial in trials:
            lines += unknown_streams(streams.keys(), trial.behavior, trial.detectors, trial.signals)
            try:
                trial.guard.check_streams(
                    streams | {signal.info.name: signal.info for signal in trial.signals}
                )
            except GuardRefusal as refusal:
                lines.append(str(refusal))
    yield from (Finding(False, line, of_profile=True) for line in dict.fromkeys(lines))


def _listen(
    rig: Rig, scene: TrialScene, infos: dict[str, DeviceInfo]
) -> tuple[dict[str, list[SampleBlock]], list[Status]]:
    """What the bench sends in a second: blocks by stream, and statuses."""
    blocks: dict[str, list[SampleBlock]] = {}
    statuses: list[Status] = []
    rig.clock.restart()
    rig.begin_trial(scene)
    for name, info in infos.items():
        rig.devices[name].apply(Listen(name, frozenset(info.streams)))
    while rig.clock.now() < LISTEN_S:
        rig.clock.wait_until(rig.clock.now() + TURN_S)
        for name in infos:
            for block in rig.devices[name].read():
                blocks.setdefault(block.stream, []).append(block)
            statuses += rig.devices[name].poll()
    for name in infos:
        rig.devices[name].apply(Listen(name, frozenset()))
    return blocks, statuses


def _identity(name: str, info: DeviceInfo) -> Finding:
    known = [info.model, info.serial and f"serial {info.serial}", info.version and f"version {info.version}"]
    details = [f"{key} {value}" for key, value in info.details.items()]
    return Finding(True, f"{name}: {', '.join(part for part in [*known, *details] if part)}")


def _reading(stream: StreamInfo, blocks: Sequence[SampleBlock]) -> Finding:
    if not blocks:
        if stream.rate_hz is None:
            return Finding(
                True, f"    {stream.name}: nothing in {LISTEN_S:g} s; it sends when something happens"
            )
        return Finding(False, f"    {stream.name}: silent for {LISTEN_S:g} s; is the sensor plugged in?")
    values = np.concatenate([block.physical for block in blocks])
    if not np.isfinite(values).all():
        return Finding(
            False, f"    {stream.name}: reads values that are not finite; is the sensor plugged in?"
        )
    means, spreads = values.mean(axis=0), values.std(axis=0)
    means = ", ".join(
        f"{channel} {mean:.6g} +- {spread:.2g}"
        for channel, mean, spread in zip(stream.channels, means, spreads, strict=True)
    )
    return Finding(
        True, f"    {stream.name}: {len(values)} samples in {LISTEN_S:g} s, {means} {stream.unit}".rstrip()
    )


def _trouble(status: Status) -> Finding:
    if isinstance(status, Lost):
        return Finding(False, f"    {status.stream}: {status.samples} samples lost")
    reason = getattr(status, "reason", "")
    return Finding(False, f"    {type(status).__name__.lower()}: {reason}")
