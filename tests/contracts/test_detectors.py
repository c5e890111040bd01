"""One suite for every detector: what it is given in which pieces must not matter."""

import numpy as np
import pytest

from behaviors.events import Contact
from controller.detectors.calibration import Statistic, courses_of
from controller.detectors.contract import ALARMS, CLAUSES, check_contract, trace
from controller.detectors.protocol import NOTHING
from controller.registry import KINDS, find
from drivers.core.messages import SampleBlock

RATE_HZ = 1024.0
"""Sample times are exact: pieces and the whole have the same."""


def with_a_lost_block(stream, values, end, begin, unit):
    """Two blocks, and nothing of the samples from `end` to `begin`."""
    return [
        SampleBlock(stream, 0, 0.0, values[:end], rate_hz=RATE_HZ, unit=unit),
        SampleBlock(stream, begin, begin / RATE_HZ, values[begin:], rate_hz=RATE_HZ, unit=unit),
    ]


def resonance_input():
    """Periods of a finger that wanders, is touched, and is released; made by no plant."""
    rng = np.random.default_rng(5)
    frequencies = np.concatenate(
        [
            28.0 + 0.05 * rng.standard_normal(400),
            31.0 + rng.standard_normal(50),
            28.0 + 0.05 * rng.standard_normal(90),
        ]
    )
    lengths_s = 1.0 / frequencies
    ends_s = np.cumsum(lengths_s)
    return [SampleBlock("board.period", 0, float(ends_s[0]), lengths_s[:, None], times_s=ends_s, unit="s")]


def waveform_input():
    """A finger's waveform: free for 10 s, stiffened by a contact that gives and takes, free again; and a lost block."""
    rng = np.random.default_rng(10)
    t_s = np.arange(16000) / RATE_HZ
    touched = (t_s > 11.0) & (t_s < 12.0)
    frequency = 28.0 + np.where(touched, 3.0 + 4.0 * np.sin(50.0 * t_s), 0.0)
    x = 1.8 * np.sin(2.0 * np.pi * np.cumsum(frequency) / RATE_HZ) + 0.05 * rng.standard_normal(t_s.size)
    return with_a_lost_block("board.accelerometer", x[:, None], 15000, 15100, "m/s2")


def force_input():
    """Nothing, a force, nothing."""
    force_n = np.concatenate([np.zeros(1000), np.full(300, 2.0), np.zeros(500)])
    force_n += 0.01 * np.random.default_rng(6).standard_normal(force_n.size)
    return [SampleBlock("board.fingertip", 0, 0.0, force_n[:, None], rate_hz=RATE_HZ, unit="N")]


def border_input():
    """A contact that wanders over the tip to one side and back, and a lost block."""
    angle_rad = np.concatenate([np.linspace(0.0, -1.2, 1500), np.linspace(-1.2, 0.0, 1500)])
    forces_n = 4.0 * np.column_stack([np.sin(angle_rad), np.cos(angle_rad)])
    forces_n += 0.035 * np.random.default_rng(11).standard_normal(forces_n.shape)
    return with_a_lost_block("signals.tip", forces_n, 2000, 2050, "N")


def slip_input():
    """Noise of two channels; for a second knocks that ring at 180 Hz in one of them; and a lost block after it."""
    rng = np.random.default_rng(7)
    noise = 0.003 * rng.standard_normal((5 * 1024, 2))
    since_s = np.arange(200) / RATE_HZ
    ring = np.exp(-34.0 * since_s) * np.sin(2.0 * np.pi * 180.0 * since_s)
    knocks = np.where(rng.random(1024) < 0.2, 0.3 * rng.standard_normal(1024), 0.0)
    noise[2048:3072, 1] += np.convolve(knocks, ring)[:1024]
    return with_a_lost_block("board.tangential", noise, 4000, 4100, "V")


def pretouch_input():
    """A finger that rests, comes nearer at 2 cm/s, waits and goes back, with a lost block; and the mover's encoder."""
    rng, t_s = np.random.default_rng(8), np.arange(8192) / RATE_HZ
    way_m = np.interp(t_s, [0.0, 1.0, 3.5, 4.0, 6.5, 8.0], [0.0, 0.0, 0.05, 0.05, 0.0, -0.03])
    gap_m = 0.055 - way_m
    z = 0.1 - 0.05j + 0.001 * (1.0 + gap_m / 0.01) ** -2 * np.exp(-2j * np.pi * gap_m / 0.0043)
    z += 1.5e-4 * (rng.standard_normal(8192) + 1j * rng.standard_normal(8192))
    values = np.column_stack([z.real, z.imag])
    return [
        *with_a_lost_block("signals.right", values, 5000, 5040, "FS"),
        SampleBlock("arm.position", 0, 0.0, way_m[::2, None], rate_hz=RATE_HZ / 2.0, unit="m"),
    ]


def level_input():
    """A level in noise that another one takes the place of for a second."""
    values = 0.1 + 1e-5 * np.random.default_rng(9).standard_normal((6144, 2))
    values[3000:4100] += (0.01, -0.004)
    return [SampleBlock("signals.right", 0, 0.0, values, rate_hz=RATE_HZ, unit="FS")]


def knock_input():
    """Noise, a second of stronger noise and a blow, and a lost block between them."""
    values = 0.003 * np.random.default_rng(11).standard_normal((6144, 1))
    values[2048:3072] *= 8.0
    values[5000:5040] *= 100.0
    return with_a_lost_block("board.accelerometer", values, 4000, 4100, "m/s2")


def load_input():
    """A pad's three forces; the last is nothing, grows, falls, and a block is lost."""
    force_n = np.zeros((2048, 3))
    force_n[:, 2] = np.interp(np.arange(2048), [1000, 1300, 1500, 1700], [0.0, 2.0, 2.0, 0.5])
    force_n += 0.005 * np.random.default_rng(12).standard_normal(force_n.shape)
    return with_a_lost_block("signals.pad", force_n, 1600, 1650, "N")


INPUTS = {
    "border": border_input,
    "level": level_input,
    "level.paper": level_input,
    "pretouch": pretouch_input,
    "pretouch.paper": pretouch_input,
    "force.threshold": force_input,
    "load": load_input,
    "onset": knock_input,
    "resonance": waveform_input,
    "resonance.paper": resonance_input,
    "slip": slip_input,
    "slip.paper": slip_input,
}


def made(kind):
    detector, settings, _ = find("detector", kind)
    return detector("name", settings())


@pytest.mark.parametrize("clause", CLAUSES, ids=lambda clause: clause.__name__)
@pytest.mark.parametrize("kind", KINDS["detector"])
def test_each_detector_keeps_each_clause(kind, clause):
    clause(lambda: made(kind), INPUTS[kind]())


@pytest.mark.parametrize("kind", KINDS["detector"])
def test_the_clauses_are_tried_with_an_alarm_and_readings(kind):
    events, readings = trace(made(kind), INPUTS[kind]())
    # a load is told as it is: no number exceeds a threshold
    assert (ALARMS | {"LoadChanged"}) & {type(event).__name__ for event in events}
    assert len(readings) > 10


STATED = sorted(kind for kind in KINDS["detector"] if isinstance(made(kind), Statistic))


@pytest.mark.parametrize("kind", STATED)
def test_a_statistic_is_what_push_holds_against_the_threshold(kind):
    """A threshold is set by it."""
    alarm = next(each for each in trace(made(kind), INPUTS[kind]())[0] if type(each).__name__ in ALARMS)
    course = courses_of(made(kind), INPUTS[kind]())[0]
    first = int(np.argmax(np.nan_to_num(course.statistic) > alarm.threshold))
    assert course.times_s[first] == alarm.t_s
    # of `resonance` it is as rare as in a long baseline
    assert course.statistic[first] == alarm.value or kind == "resonance"


class Peak:
    """Contact where the largest sample so far exceeds 1; `flaw` breaks a clause."""

    def __init__(self, flaw):
        self.name, self.inputs, self.flaw = "peak", ("board.fingertip",), flaw
        self._contact, self.readings = False, NOTHING

    def reset(self):
        self._contact, self.readings = self.flaw == "remembers", NOTHING

    def warm_up(self):
        self._contact |= self.flaw == "warms"

    def push(self, block):
        values = block.physical[:, 0]
        (above,) = np.nonzero(~(values < 1.0) if self.flaw == "nan" else np.isfinite(values) & (values > 1.0))
        self.readings = NOTHING
        if self._contact or not above.size:
            return []
        self._contact = self.flaw != "repeats"
        now_s = float(block.times[-1 if self.flaw == "late" else above[0]])
        now_s += 1e-4 * (self.flaw == "between")
        value = float(values[above[0]])
        self.readings = np.array([[now_s, value, 2.0 if self.flaw == "reading" else 1.0]])
        return [Contact(now_s, self.name, value, 1.0)]


@pytest.mark.parametrize(
    ("flaw", "said"),
    [
        ("repeats", "blocks of 1 give"),
        ("late", "blocks of 1 give"),
        ("remembers", "after a reset it gives"),
        ("between", "no sample has the time"),
        ("nan", "samples that are all nan"),
        ("warms", "warm_up changes its state"),
        ("reading", "beside the readings"),
    ],
)
def test_a_detector_that_breaks_a_clause_is_refused(flaw, said):
    with pytest.raises(AssertionError, match=said):
        check_contract(lambda: Peak(flaw), force_input())


def test_samples_in_which_nothing_is_found_prove_nothing():
    with pytest.raises(AssertionError, match="no event follows"):
        check_contract(lambda: Peak(""), force_input()[:0])
