"""Signals: streams computed from other streams, while they are subscribed."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

from controller.own_modules import is_shipped, pushed
from drivers.core.messages import SampleBlock, Saturated, StreamInfo


class Signal(Protocol):
    """Makes one stream out of others: calibrated forces out of bridges, an envelope out of a carrier.

    Pure, as a detector is: the same samples in give the same samples out, however they are cut into blocks. A sample's
    time is that of the event it shows: filter delays are compensated. Lost samples leave a jump in `seq`. One with
    findings for the manifest has a method `account()`: those since the last reset, by name; a `warning` is shown to the
    operator.
    """

    name: str

    @property
    def inputs(self) -> tuple[str, ...]:
        """Streams it subscribes to: `device.stream`, or another signal's `signals.name`."""

    info: StreamInfo
    """The output stream; its name is `signals.` and the signal's own."""

    def push(self, block: SampleBlock) -> Sequence[SampleBlock | Saturated]:
        """Process the next block of one of the inputs."""

    def reset(self) -> None:
        """Return to the initial state."""


class Signals:
    """The signals of a trial; those without a subscriber cost nothing.

    Args:
        signals: In any order.
    """

    def __init__(self, signals: Iterable[Signal] = ()) -> None:
        self._made: Mapping[str, Signal] = {signal.info.name: signal for signal in signals}
        self._awake: list[Signal] = []

    @property
    def streams(self) -> frozenset[str]:
        """Streams that can be subscribed."""
        return frozenset(self._made)

    @property
    def awake(self) -> Sequence[Signal]:
        """Signals with a subscriber."""
        return self._awake

    def subscribe(self, streams: frozenset[str]) -> frozenset[str]:
        """Activate the signals among `streams` and their sources, deactivate the others.

        A newly activated signal is reset.

        Returns:
            The devices' streams that are needed.
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
            awake[stream] = signal  # after its inputs

    def push(self, blocks: Sequence[SampleBlock]) -> tuple[list[SampleBlock], list[Saturated]]:
        """Process one turn's blocks; returns the active signals' blocks, and their `Saturated` statuses.

        Raises:
            ValueError: a signal cannot use its stream, or returns what is neither.
        """
        made: list[SampleBlock] = []
        saturated: list[Saturated] = []
        for signal in self._awake:
            for block in [*blocks, *made]:
                if block.stream in signal.inputs:
                    name = "" if is_shipped(signal) else signal.info.name
                    for thing in pushed(signal, name, block, _either, "blocks"):
                        if isinstance(thing, SampleBlock):
                            made.append(thing)
                        else:
                            saturated.append(thing)
        return made, saturated


def _either(thing: object) -> bool:
    return isinstance(thing, SampleBlock | Saturated)
