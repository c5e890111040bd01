"""Whether the streams that a trial subscribes to exist, checked before anything moves."""

from collections.abc import Iterator, Mapping, Sequence, Set
from difflib import get_close_matches

from behaviors.machine import Behavior
from controller.detectors.protocol import Detector
from controller.signals.protocol import Signal


def unknown_streams(
    streams: Set[str], behavior: Behavior, detectors: Mapping[str, Detector], signals: Sequence[Signal] = ()
) -> Sequence[str]:
    """Streams that some state subscribes to and nothing sends; streams without a subscriber are not checked.

    Args:
        streams: What the open devices send, as `device.stream`.
        detectors: By the names that the behavior knows them by.
        signals: What is made of the devices' streams.

    Returns:
        A line for each, with its subscriber and what there is instead.
    """
    plans = [plan for plans in behavior.foreseen.values() for plan in plans]
    asked = [
        (detector, stream)
        for detector in sorted({name for plan in plans for name in plan.detectors})
        for stream in detectors[detector].inputs
    ]
    asked += [("behavior", stream) for stream in sorted({name for plan in plans for name in plan.measures})]
    made = {signal.info.name: signal for signal in signals}
    found = dict.fromkeys(
        f"{subscriber} subscribes to {missing(stream, streams | made.keys())}"
        for subscriber, stream in _followed(asked, made)
        if stream not in streams
    )
    return list(found)


def _followed(asked: Sequence[tuple[str, str]], made: Mapping[str, Signal]) -> Iterator[tuple[str, str]]:
    """Through the signals to the streams of devices."""
    for subscriber, stream in asked:
        if stream in made:
            yield from _followed([(stream, source) for source in made[stream].inputs], made)
        else:
            yield subscriber, stream


def missing(stream: str, known: Set[str]) -> str:
    """That a stream is not there, and what is."""
    near = get_close_matches(stream, sorted(known), n=1)
    hint = f"did you mean {near[0]}?" if near else f"it has {', '.join(sorted(known))}"
    return f"{stream}: the bench has no such stream; {hint}"
