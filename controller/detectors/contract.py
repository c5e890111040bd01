"""What holds for every detector, shipped or the user's own; each clause takes samples in which it finds something."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from behaviors.events import BaselineRefused, Detected
from controller.detectors.protocol import NOTHING, Compiled, Detector, readings_of
from drivers.core.messages import Floats, SampleBlock

Make = Callable[[], Detector]
Blocks = Sequence[SampleBlock]

ALARMS = frozenset(("BorderNear", "Contact", "Onset", "PreTouch", "SlipStarted"))
"""What a detector reports because its number exceeds its threshold."""

SIZES = (1, 7, 64)
"""Samples in a block."""


def check_contract(make: Make, blocks: Blocks) -> None:
    """Check all clauses; raises `AssertionError` with the first that does not hold.

    The blocks are read-only, as on a bench, where others get the same ones: who writes to them raises a `ValueError`.

    Args:
        make: Makes the detector, each time a new one.
        blocks: Of its inputs, with their times; at least one event must follow from them.
    """
    kept = [block.read_only() for block in blocks]
    for clause in CLAUSES:
        clause(make, kept)


def blocks_of_any_size_give_the_same(make: Make, blocks: Blocks) -> None:
    """The loop cuts a stream where it happens to read it: the same events, and `readings`, where it has them."""
    expected, shown = trace(make(), blocks)
    _hold(bool(expected), "no event follows from these samples; give some in which it finds something")
    for size in SIZES:
        found, readings = trace(make(), [part for block in blocks for part in cut(block, size)])
        _hold(_alike(found, expected), f"blocks of {size} give {found}, the whole {expected}")
        same = np.array_equal(readings, shown, equal_nan=True)  # a threshold that is not known yet
        _hold(same, f"blocks of {size} give other readings than the whole")


def after_a_reset_it_is_as_new(make: Make, blocks: Blocks) -> None:
    """The loop resets a detector where a state arms it."""
    detector = make()
    first, _ = trace(detector, blocks)
    detector.reset()
    _hold(len(readings_of(detector)) == 0, "its readings outlive a reset")
    again, _ = trace(detector, blocks)
    _hold(_alike(again, first), f"after a reset it gives {again}, before {first}")


def events_have_their_samples_time_in_order(make: Make, blocks: Blocks) -> None:
    """An event is dated by the sample that decided."""
    times_s = [event.t_s for event in trace(make(), blocks)[0]]
    strange = set(times_s) - {t_s for block in blocks for t_s in block.times.tolist()}
    _hold(not strange, f"no sample has the time of the events at {sorted(strange)} s")
    _hold(times_s == sorted(times_s), f"events go back in time: {times_s} s")


def values_that_are_not_finite_raise_no_alarm(make: Make, blocks: Blocks) -> None:
    """A broken sensor is no event; a missing baseline may be reported."""
    for bad in (np.nan, np.inf, -np.inf):
        detector = make()
        for block in blocks:
            spoiled = replace(block, values=np.full_like(block.physical, bad), scale=1.0)
            found = [event for event in detector.push(spoiled) if not isinstance(event, BaselineRefused)]
            _hold(not found, f"{found} from samples that are all {bad}")


def warming_up_changes_nothing(make: Make, blocks: Blocks) -> None:
    """Compiled numerics may be loaded at any time."""
    warmed, found = make(), list[Detected]()
    if not isinstance(warmed, Compiled):
        return
    for block in blocks:
        for part in cut(block, 500):
            warmed.warm_up()
            found += warmed.push(part)
    _hold(_alike(found, trace(make(), blocks)[0]), "warm_up changes its state")


def an_alarm_is_among_the_readings(make: Make, blocks: Blocks) -> None:
    """The `readings` of the push that alarms, where it has them, hold what it alarmed by."""
    detector = make()
    if not hasattr(detector, "readings"):
        return
    for block in blocks:
        for part in cut(block, 64):
            for alarm in detector.push(part):
                if type(alarm).__name__ in ALARMS:
                    decided = [alarm.t_s, alarm.value, alarm.threshold]
                    readings = readings_of(detector).tolist()
                    _hold(decided in readings, f"{alarm} is not beside the readings {readings}")
                    _hold(alarm.value > alarm.threshold, f"{alarm} is not above its threshold")


CLAUSES = (
    blocks_of_any_size_give_the_same,
    after_a_reset_it_is_as_new,
    events_have_their_samples_time_in_order,
    values_that_are_not_finite_raise_no_alarm,
    warming_up_changes_nothing,
    an_alarm_is_among_the_readings,
)


def cut(block: SampleBlock, size: int) -> Iterator[SampleBlock]:
    """A block in pieces of at most `size` samples."""
    return (part(block, start, start + size) for start in range(0, len(block), size))


def part(block: SampleBlock, first: int, last: int) -> SampleBlock:
    """The samples first <= k < last of a block, at least one."""
    return replace(
        block,
        seq=block.seq + first,
        t0_s=float(block.times[first]),
        values=block.values[first:last],
        times_s=None if block.times_s is None else block.times_s[first:last],
    )


def trace(detector: Detector, blocks: Blocks) -> tuple[list[Detected], Floats]:
    """Events and readings, shape (n, 3), of all blocks."""
    events: list[Detected] = []
    readings = [NOTHING]
    for block in blocks:
        events += detector.push(block)
        readings.append(readings_of(detector))
    return events, np.concatenate(readings)


def _alike(found: Sequence[Detected], others: Sequence[Detected]) -> bool:
    """Whether events are equal; a position that is not known, NaN, is equal to another."""
    return repr(found) == repr(others)


def _hold(holds: bool, failure: str) -> None:
    if not holds:
        raise AssertionError(failure)
