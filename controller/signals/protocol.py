"""Signals: streams that are made of other streams, where somebody hears them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol, runtime_checkable

from drivers.messages import SampleBlock, Saturated, StreamInfo


class Signal(Protocol):
    """Makes one stream out of others: calibrated forces out of bridges, an envelope out of a carrier.

    Pure, as a detector is: the same samples in give the same samples out, however they are cut into blocks. A sample's
    time is the time of what it tells of; a filter's delay is taken off. Lost samples leave a jump in `seq`.
    """

    name: str

    @property
    def inputs(self) -> tuple[str, ...]:
        """Streams it hears: `device.stream`, or another signal's `signals.name`."""

    info: StreamInfo
    """What comes out; its name is `signals.` and the signal's own."""

    def push(self, block: SampleBlock) -> Sequence[SampleBlock | Saturated]:
        """Hear the next block of one of the inputs."""

    def reset(self) -> None:
        """Forget everything, as on the day it was made."""


@runtime_checkable
class Accountable(Protocol):
    """A signal that knows something about the bench which belongs into the manifest."""

    def account(self) -> Mapping[str, object]:
        """What it found since its last reset; a `warning` in it is told to the person at the bench."""


class Signals:
    """The signals of a trial; those that nobody hears cost nothing.

    Args:
        signals: By any name.
    """

    def __init__(self, signals: Iterable[Signal] = ()) -> None:
        self._made: Mapping[str, Signal] = {signal.info.name: signal for signal in signals}
        self._awake: list[Signal] = []

    @property
    def streams(self) -> frozenset[str]:
        """What can be heard."""
        return frozenset(self._made)

    @property
    def awake(self) -> Sequence[Signal]:
        """Those that somebody hears."""
        return self._awake

    def hear(self, streams: frozenset[str]) -> frozenset[str]:
        """Wake the signals among `streams` and those behind them, put the others to sleep.

        A signal that wakes begins anew.

        Returns:
            The devices' streams that are needed for it.
        """
        awake: dict[str, Signal] = {}
        devices: set[str] = set()
        for stream in sorted(streams):
            self._follow(stream, awake, devices)
        for signal in awake.values():
            if signal not in self._awake:
                signal.reset()
        self._awake = list(awake.values())
        return frozenset(devices)

    def _follow(self, stream: str, awake: dict[str, Signal], devices: set[str]) -> None:
        signal = self._made.get(stream)
        if signal is None:
            devices.add(stream)
        elif stream not in awake:
            for source in signal.inputs:
                self._follow(source, awake, devices)
            awake[stream] = signal  # after what it hears

    def push(self, blocks: Sequence[SampleBlock]) -> tuple[list[SampleBlock], list[Saturated]]:
        """What the waking signals make of one turn's blocks: blocks of their own, and words about their range."""
        made: list[SampleBlock] = []
        saturated: list[Saturated] = []
        for signal in self._awake:
            for block in [*blocks, *made]:
                if block.stream in signal.inputs:
                    for thing in signal.push(block):
                        if isinstance(thing, SampleBlock):
                            made.append(thing)
                        else:
                            saturated.append(thing)
        return made, saturated
