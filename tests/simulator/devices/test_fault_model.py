"""When a fault is on, what it counts from, what a sensor reads then, and that it is marked when it takes effect."""

from __future__ import annotations

import numpy as np
import pytest

from config.faults import fault_of
from drivers.core.clock import VirtualClock
from drivers.core.messages import Failed, SampleBlock
from drivers.core.wire import Driver
from simulator.devices.faults import Fault, FaultSchedule, FaultyClock, Keys, corrupted, faulty


def schedule(**fault):
    return FaultSchedule([Fault(**{"device": "board", "kind": "silent", **fault})])


def test_a_fault_in_a_state_counts_from_its_first_entry():
    faults = schedule(after="APPROACH", at_s=0.1, for_s=0.08)
    assert not faults.active(5.0, "silent")
    faults.mark("APPROACH", 2.0)
    faults.mark("APPROACH", 9.0)
    assert [faults.active(t_s, "silent") for t_s in (2.09, 2.1, 2.179, 2.181, 9.15)] == [
        False, True, True, False, False,
    ]  # fmt: skip


def test_a_burst_comes_as_often_as_it_says_and_a_periodic_one_for_good():
    burst = schedule(at_s=1.0, for_s=0.1, every_s=1.0, times=2)
    assert [burst.active(t_s, "silent") for t_s in (1.05, 1.5, 2.05, 3.05)] == [True, False, True, False]
    periodic = schedule(at_s=1.0, for_s=0.1, every_s=1.0)
    assert [periodic.active(t_s, "silent") for t_s in (3.05, 3.5, 1001.05)] == [True, False, True]
    stalls = schedule(kind="stall", at_s=1.0, for_s=0.1, every_s=1.0, times=2)
    assert [stalls.begun(t_s, "stall") is not None for t_s in (0.5, 1.0, 1.2, 2.3, 2.4, 9.0)] == [
        False, True, False, True, False, False,
    ]  # fmt: skip


def test_a_fault_is_marked_when_it_first_took_effect_in_each_trial():
    faults = schedule(at_s=1.0, trial=2)
    for trial in (1, 2):
        faults.restart(trial)
        for t_s in (0.5, 1.25, 1.5):
            faults.active(t_s, "silent")
    assert [(each["trial"], each["effect_s"]) for each in faults.shown()] == [(2, 1.25)]


def test_until_when_nothing_can_happen_is_known():
    faults = schedule(at_s=2.0, for_s=0.5, every_s=1.0, times=2)
    assert [faults.quiet_until_s(t_s) for t_s in (0.0, 2.1, 2.6, 3.6)] == [2.0, 2.1, 3.0, np.inf]
    counted = schedule(after="load 2")
    assert counted.quiet_until_s(1.0) == 1.0, "no one knows when the second sample comes"
    for after in ("write 2", "MoveAt 2"):
        assert schedule(after=after).quiet_until_s(1.0) == np.inf, "a command is sent in a turn of its own"
    assert schedule(kind="drift").quiet_until_s(1.0) == np.inf, (
        "what a sensor reads goes by its samples' own times"
    )
    assert schedule(after="HOLDING").quiet_until_s(1.0) == np.inf, "a state is entered in a turn of its own"
    stalls = schedule(kind="stall", at_s=2.0, for_s=0.1)
    assert stalls.quiet_until_s(2.5) == 2.5, "it was not taken yet"
    pause = schedule(kind="pause", at_s=2.0)
    assert pause.begun(2.5, "pause")
    assert pause.quiet_until_s(2.6) == np.inf, "it was for an instant, though no end is given"
    late = schedule(kind="late", at_s=2.0, for_s=1.0, amount=0.5)
    assert late.quiet_until_s(3.4) == 3.4, "what came last is still on its way"
    assert late.quiet_until_s(3.6) == np.inf
    assert schedule(kind="refuse").quiet_until_s(1.0) == np.inf, "only a command is refused"
    gone = schedule(kind="unplug", at_s=2.0)
    assert gone.begun(2.5, "unplug")
    assert gone.quiet_until_s(2.6) == 2.6, "it stays away"


class Sensor(Driver):
    """Sends the count of its calls."""

    def __init__(self):
        super().__init__("board", VirtualClock())
        self.calls = 0
        self.made = np.int32

    def restart(self) -> None: ...

    def read(self):
        self.calls += 1
        values = np.full((2, 1), self.calls, self.made)
        return [SampleBlock("board.load", 2 * self.calls, self._clock.now(), values, 100.0, scale=0.5)]

    def poll(self):
        return [Failed(self._clock.now(), "board", "")]


def sensor(**fault):
    faults = schedule(**fault)
    made = faulty(Sensor, faults)()
    made.restart()

    def read(t_s):
        made._clock.wait_until(t_s)
        return [block.values.ravel().tolist() for block in made.read()]

    return made, read


def test_what_a_sensor_reads_is_stuck_wrong_and_drifts():
    _, stuck = sensor(kind="stuck", at_s=1.0)
    assert stuck(0.5) == [[1, 1]]
    assert stuck(1.5) == [[1, 1]]
    _, wrong = sensor(kind="wrong", at_s=1.0, for_s=1.0)
    assert (wrong(0.5), wrong(1.5), wrong(2.5)) == ([[1, 1]], [[-2, -2]], [[3, 3]])
    _, drifts = sensor(kind="drift", at_s=1.0, amount=5.0)
    assert drifts(2.99) == [[21, 21]], "two seconds at 5 units a second, half a unit a count"
    _, beyond = sensor(kind="wrong", amount=1e12)
    assert beyond(0.0) == [[np.iinfo(np.int32).max] * 2], "as far as its converter goes"


@pytest.mark.parametrize("kind", ["stuck", "wrong", "drift"])
@pytest.mark.parametrize("lasts", [{}, {"for_s": 0.05}, {"for_s": 0.02, "every_s": 0.1}])
def test_what_a_sensor_reads_is_the_same_however_its_samples_are_cut(kind, lasts):
    def read(cut):
        faults = schedule(kind=kind, at_s=0.033, amount=1e5, **lasts)
        values = np.arange(1, 41)[:, None] * 1000
        blocks = [
            SampleBlock("board.load", first, first / 100.0, values[first : first + cut], 100.0)
            for first in range(0, 40, cut)
        ]
        seen = np.concatenate([faults.seen(block).values for block in blocks]).ravel().tolist()
        return seen, [effect["effect_s"] for effect in faults.shown()]

    whole, effects = read(40)
    assert effects == [0.04], "the first sample after it began"
    assert whole[:4] == [1000, 2000, 3000, 4000]
    assert whole[4] != 5000
    for cut in (1, 3, 7):
        assert read(cut) == (whole, effects)
    if lasts:
        assert whole[9] == 10_000, "it is over"


def test_what_is_late_comes_later_in_its_order_and_whole():
    device, read = sensor(kind="late", at_s=1.0, for_s=0.5, amount=0.3)
    assert read(0.9) == [[1, 1]]
    assert read(1.0) == []
    assert device.poll() == []
    assert read(1.2) == []
    assert read(1.35) == [[2, 2]]
    assert len(device.poll()) == 1
    assert read(1.6) == [[3, 3]]
    assert read(3.0)[-1] == [device.calls, device.calls]


def test_a_fault_counts_from_the_nth_sample_and_the_nth_command():
    _, read = sensor(kind="wrong", after="load 3")
    assert (read(0.0), read(0.1)) == ([[1, 1]], [[-2, -2]]), "the third sample is the second block's first"


def test_bytes_come_twice():
    assert corrupted(schedule(kind="double"), b"ab", 0.0) == b"abab"
    assert corrupted(schedule(kind="double", at_s=1.0), b"ab", 0.0) == b"ab"


def test_a_loop_hangs_once_and_a_key_is_pressed_and_a_pause_ends():
    clock = FaultyClock(FaultSchedule([Fault(device="loop", kind="hang", at_s=1.0, amount=0.25)]))
    clock.wait_until(0.9)
    clock.wait_until(1.1)
    assert clock.now() == pytest.approx(1.35)
    clock.wait_until(1.4)
    assert clock.now() == pytest.approx(1.4)
    keys = Keys(FaultSchedule([Fault(device="keys", kind="pause", at_s=1.2)]), clock)
    assert [keys.pressed(), keys.pressed(), keys.pressed()] == ["pause", "resume", None]


@pytest.mark.parametrize(
    "wrong",
    [
        {"times": 3},
        {"every_s": 1.0},
        {"every_s": 1.0, "for_s": 1.0},
        {"after": "approach"},
        {"after": "write 0"},
    ],
)
def test_a_fault_that_makes_no_sense_is_refused(wrong):
    with pytest.raises(ValueError, match=r"every_s|times|after"):
        schedule(**wrong)


def test_a_fault_in_words_is_one_of_a_profile():
    assert fault_of("board freeze 80 ms in APPROACH") == {
        "device": "board", "kind": "silent", "for_s": 0.08, "after": "APPROACH",
    }  # fmt: skip
    assert fault_of("arm late 2 s by 0.3 at 500 ms after MoveAt 2 every 3 s times 4 trial 2") == {
        "device": "arm", "kind": "late", "for_s": 2.0, "amount": 0.3, "at_s": 0.5, "after": "MoveAt 2", "every_s": 3.0,
        "times": 4, "trial": 2,
    }  # fmt: skip
    assert fault_of("board intermittent") == {
        "device": "board",
        "kind": "lose",
        "for_s": 0.02,
        "every_s": 0.1,
    }
    for words in ("board", "board freeze in approach", "board freeze 80"):
        with pytest.raises(ValueError, match="is no fault; write DEVICE KIND"):
            fault_of(words)
