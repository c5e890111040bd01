"""B8: events of each slip detector, true slip, and the paper's statistic."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from behaviors.events import (
    Event,
    GuardStopped,
    Paused,
    SlipEnded,
    SlipStarted,
)
from behaviors.slip import RollSlipSettings, SensorRunSettings
from controller.detectors.slip import SlipDetector
from controller.measures.trial import Measured, TrialEvidence, delay_s, not_before, spans_within, without
from controller.recording.series import Span
from controller.signals.spectrum import BlockCutter, block_peaks
from drivers.core.messages import Floats, SampleBlock

DETECTORS = ("paper", "ours")

_EACH = {
    "detected": "slips reported in time",
    "missed": "slips that were not; one cut short before it could be detected is none of the three",
    "early": (
        "slips reported between the arm's start and the true slip, or that began while slip was reported already: "
        "neither detected nor missed, but a false alarm"
    ),
    "delay_s": "median delay of those detected",
    "first_delay_s": "delay of the first one",
    "event_s": "when the first event after `slide_s` was",
    "false_alarms": "false alarms in `quiet_s`",
    "touch_alarms": "false alarms during descent and pressing",
    "quiet_s": "other time without slip in which it could have alarmed",
}

HIGHLIGHTS = ("ours_delay_s", "paper_delay_s", "ours_false_alarms")
"""Columns shown during a run."""

COLUMNS = {
    "clock_s": "when the paper's time axis begins",
    "touch_truth_s": "when the tip touched, in truth (simulated benches)",
    "touch_s": "when contact was detected",
    "press_n": "mean force from the end of pressing to lifting",
    "reference": "origin of the delays: true slip on a simulated bench, or the command to slide",
    "slips": "how many there were",
    "slide_s": "when the first command to slide was given",
    "slip_s": "when the first slip began",
    "slip_end_s": "when the last ended",
    "listen_s": "when the slip detectors were subscribed",
    **{f"{detector}_{what}": meaning for detector in DETECTORS for what, meaning in _EACH.items()},
    "ours_least_delay_s": "our detector's shortest delay, whatever the slip",
    "peak_product": "the paper's statistic: its largest product of peak and frequency in slip",
    "peak_product_before": "between pressing and slip",
    "dominant_hz": "frequency that dominates in slip",
    "slip_to_stop_s": "from the deciding sample to the stop command",
    "stop_travel_m": "the tool's way from there to standstill",
}

BLOCK_S = 0.064
SLOW_BLOCK_S = 0.16
SLOW_HZ = 200.0
"""Blocks of the paper's statistic: N = 64 at 1 kHz (section 3), N = 16 at 100 Hz (5.4)."""

AFTER_S = 0.2
"""Slip reported this soon after its end is late, not false: a block and a half of the slowest sensor."""


class Slip(NamedTuple):
    """A slip, or a stretch that may hold one: bench time in seconds of its beginning and its end, and when it was
    commanded."""

    begin_s: float
    end_s: float
    commanded_s: float = math.nan


def measure(evidence: TrialEvidence, settings: RollSlipSettings, outcome: str) -> Measured:
    """Measure one trial."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    run = settings.sensors[evidence.factors["sensor"]]
    row["clock_s"] = evidence.entered_s.get("RESTING")
    touch = evidence.ending_contact(run.touch)
    row["touch_s"] = None if touch is None else touch.t_s
    row["touch_truth_s"] = evidence.touched_s()
    _require_samples(evidence, run, row["touch_s"])
    commanded = _commanded(evidence)
    true_slips = None if evidence.slips is None else [Slip(*span) for span in spans_within(evidence.slips)]
    slips = commanded if true_slips is None else _true(commanded, true_slips)
    row["reference"] = "command" if true_slips is None else "truth"
    row["slips"] = len(slips)
    row["slide_s"] = commanded[0].begin_s if commanded else None
    if slips:
        row["slip_s"], row["slip_end_s"] = slips[0].begin_s, slips[-1].end_s
    slipping = [*slips, *(true_slips or [])]
    descent = _descent(evidence)
    row["listen_s"] = listen_s = _listen_s(evidence, run)
    arming_s, row["ours_least_delay_s"] = _ours_at_best(evidence, run)
    cuts_s = _cuts_s(evidence)
    for detector in DETECTORS:
        name = getattr(run, detector)
        if name not in evidence.detectors or evidence.unlearnt(name):
            continue
        events = _events_of(evidence.events, name, listen_s)
        if listen_s is not None:
            armed_s = listen_s + (arming_s if detector == "ours" else 0.0)
            row[f"{detector}_quiet_s"] = _quiet_s(armed_s, _silent_s(evidence, run), slipping, descent)
        scored = _score(events, slips, settings.missed_after_s, cuts_s)
        alarms = _alarms(events, slipping, descent)
        if commanded:
            after = [w.t_s for w in events if isinstance(w, SlipStarted) and w.t_s >= commanded[0].begin_s]
            row[f"{detector}_event_s"] = after[0] if after else None
        row.update({f"{detector}_{what}": value for what, value in {**scored, **alarms}.items()})
    row["press_n"] = _press(evidence, settings)
    row.update(_spectrum(evidence, run, slips, listen_s))
    row.update(_stop(evidence, settings, run))
    return outcome, row


def _require_samples(evidence: TrialEvidence, run: SensorRunSettings, touch_s: float | None) -> None:
    """Require the detectors' samples wherever their events are counted."""
    descending_s, listen_s = evidence.entered_s.get("RESTING"), _listen_s(evidence, run)
    silent_s = _silent_s(evidence, run)
    if descending_s is not None:
        evidence.require_samples(run.touch, descending_s, silent_s if touch_s is None else touch_s)
    if listen_s is not None:
        for detector in DETECTORS:
            evidence.require_samples(getattr(run, detector), listen_s, silent_s)


# --- when it slipped ------------------------------------------------------------------------------


def _commanded(evidence: TrialEvidence) -> list[Slip]:
    """From each command to slide until standstill or the next command."""
    ends_s = [*(t_s for _, t_s in evidence.visits[1:]), evidence.ended_s]
    visits = zip(evidence.visits, ends_s, strict=False)
    return [Slip(t_s, end_s, t_s) for (state, t_s), end_s in visits if state == "SLIPPING"]


def _true(commanded: Sequence[Slip], true_slips: Sequence[Slip]) -> list[Slip]:
    """True slip for each command to slide; none where the tip held."""
    found = []
    for span in commanded:
        within = [slip for slip in true_slips if slip.end_s >= span.begin_s and slip.begin_s <= span.end_s]
        if within:
            found.append(Slip(max(span.begin_s, within[0].begin_s), within[-1].end_s, span.begin_s))
    return found


def _cuts_s(evidence: TrialEvidence) -> Sequence[float]:
    """When the trial was interrupted: by the reflex, the guard, a pause or a fault.

    A step that ends as planned is no interruption: a slip not detected by then was missed.
    """
    cuts_s = [event.t_s for event in evidence.events if isinstance(event, GuardStopped | Paused)]
    cuts_s += [evidence.entered_s[state] for state in ("HALTING", "FAILED") if state in evidence.entered_s]
    return cuts_s if "LIFTING" in evidence.entered_s else [*cuts_s, evidence.ended_s]


# --- what the detectors reported ------------------------------------------------------------------


SlipEvents = Sequence[SlipStarted | SlipEnded]


def _events_of(events: Sequence[Event], detector: str, listen_s: float | None) -> SlipEvents:
    own = (
        event for event in events if isinstance(event, SlipStarted | SlipEnded) and event.detector == detector
    )
    return [event for event in own if listen_s is not None and event.t_s >= listen_s]


def _score(
    events: SlipEvents, slips: Sequence[Slip], missed_after_s: float, cuts_s: Sequence[float]
) -> Mapping[str, Any]:
    """Score slip by slip; one interrupted before the detector's time was up does not count as missed."""
    delays_s: list[float] = []
    early = missed = 0
    started_s = [event.t_s for event in events if isinstance(event, SlipStarted)]
    for slip in slips:
        before = [event for event in events if not not_before(event.t_s, slip.begin_s)]
        latest_s = min(slip.begin_s + missed_after_s, slip.end_s + AFTER_S)
        found = [t_s for t_s in started_s if not_before(t_s, slip.begin_s) and t_s <= latest_s]
        called = any(slip.commanded_s <= t_s and not not_before(t_s, slip.begin_s) for t_s in started_s)
        if called or (before and isinstance(before[-1], SlipStarted)):
            early += 1
        elif found:
            delays_s.append(delay_s(found[0], slip.begin_s))
        elif not any(slip.commanded_s <= cut_s <= latest_s for cut_s in cuts_s):
            missed += 1
    return {
        "detected": len(delays_s),
        "missed": missed,
        "early": early,
        "delay_s": float(np.median(delays_s)) if delays_s else None,
        "first_delay_s": delays_s[0] if delays_s else None,
    }


def _alarms(events: SlipEvents, slips: Sequence[Slip], descent: Slip) -> Mapping[str, int]:
    """False alarms: during descent and pressing, and at any other time."""
    started_s = [event.t_s for event in events if isinstance(event, SlipStarted)]
    alarms = [
        t_s
        for t_s in started_s
        if not any(not_before(t_s, slip.begin_s) and t_s <= slip.end_s + AFTER_S for slip in slips)
    ]
    touching = sum(descent.begin_s <= t_s < descent.end_s for t_s in alarms)
    return {"false_alarms": len(alarms) - touching, "touch_alarms": touching}


def _listen_s(evidence: TrialEvidence, run: SensorRunSettings) -> float | None:
    """When the slip detectors were subscribed; the later time where a pause before contact restarted the trial."""
    if run.listen == "rest":
        return evidence.entered_s.get("RESTING")
    moving = ("LOADING", "ROLLING", "SLIPPING")
    return next((t_s for state, t_s in evidence.visits if state in moving), None)


def _ours_at_best(evidence: TrialEvidence, run: SensorRunSettings) -> tuple[float, float | None]:
    """Learning time and shortest detection delay of our detector, s."""
    ours: object = evidence.detectors.get(run.ours or "")
    rate_hz = next((block.rate_hz for block in evidence.recording.blocks(run.stream)), None)
    if not isinstance(ours, SlipDetector) or rate_hz is None:
        return 0.0, None
    return ours.arming_s(rate_hz), ours.least_delay_s(rate_hz)


def _silent_s(evidence: TrialEvidence, run: SensorRunSettings) -> float:
    """When the slip detectors were unsubscribed; those subscribed with motion, when the reflex has stopped it."""
    states = ("LIFTING",) if run.listen == "rest" else ("LIFTING", "STOPPED")
    ends_s = (evidence.entered_s[state] for state in states if state in evidence.entered_s)
    return min(ends_s, default=evidence.ended_s)


def _quiet_s(begin_s: float, end_s: float, slipping: Sequence[Slip], descent: Slip) -> float:
    """Time in which a detector can alarm, without descent, pressing and slips."""
    busy = [Span(descent.begin_s, descent.end_s)]
    busy += [Span(span.begin_s, span.end_s + AFTER_S) for span in slipping]
    return sum(until_s - since_s for since_s, until_s in without(begin_s, end_s, busy))


def _descent(evidence: TrialEvidence) -> Slip:
    """From the beginning of the descent until the tip was pressed and its ring had died away."""
    begin_s = evidence.entered_s.get("DESCENDING", math.inf)
    pressing_s = evidence.entered_s.get("PRESSING", math.inf)
    after_s = [t_s for _, t_s in evidence.visits if t_s > pressing_s]
    return Slip(begin_s, after_s[0] + AFTER_S if after_s else math.inf)


# --- what the signals were ------------------------------------------------------------------------


def _press(evidence: TrialEvidence, settings: RollSlipSettings) -> float | None:
    """Mean force along z that the table held against the arm, from the end of pressing to lifting."""
    pressed_s = _descent(evidence).end_s
    lifted_s = evidence.entered_s.get("LIFTING", math.inf)
    series = evidence.covered(settings.force_stream, pressed_s, lifted_s)
    wanted = (series.times_s >= pressed_s) & (series.times_s <= lifted_s)
    return float(series.values[wanted, 2].mean()) if wanted.any() else None


class PaperBlocks(NamedTuple):
    """The paper's statistic, block by block, of the channel that decides; each of shape (m,).

    Attributes:
        begin_s: Bench time just before each block's first sample.
        end_s: Bench time of its last.
        power: Peak of its spectrum, the stream's unit squared; NaN where a sample is not finite.
        frequency_hz: Where the peak is; NaN likewise.
    """

    begin_s: Floats
    end_s: Floats
    power: Floats
    frequency_hz: Floats

    @property
    def product(self) -> Floats:
        """What the paper compares with its threshold."""
        return self.power * self.frequency_hz


def paper_blocks(recorded: Sequence[SampleBlock], channel: int | None, listen_s: float | None) -> PaperBlocks:
    """Cut a stream as the paper's detector does: restarted when it is subscribed, and after each gap.

    Args:
        recorded: The stream's blocks, in order, at one rate.
        channel: Which one is used; None uses all.
        listen_s: When the detector was subscribed; None where it never was.
    """
    found: list[PaperBlocks] = []
    blocks: BlockCutter | None = None
    next_seq, listening = 0, False
    for block in recorded:
        rate_hz = block.rate_hz
        if rate_hz is None or not len(block):
            continue
        if blocks is None:
            blocks = BlockCutter(round((SLOW_BLOCK_S if rate_hz < SLOW_HZ else BLOCK_S) * rate_hz))
        begins = not listening and listen_s is not None and block.times[0] >= listen_s
        if begins or block.seq != next_seq:
            blocks.reset()
        listening, next_seq = listening or begins, block.seq + len(block)
        values = block.physical if channel is None else block.physical[:, channel : channel + 1]
        ends, complete = blocks.push(values)
        end_s = block.times[ends]
        found.append(PaperBlocks(end_s - blocks.size / rate_hz, end_s, *block_peaks(complete, rate_hz)))
    if not found:
        return PaperBlocks(*(np.empty(0) for _ in PaperBlocks._fields))
    return PaperBlocks(*(np.concatenate(columns) for columns in zip(*found, strict=True)))


def _spectrum(
    evidence: TrialEvidence, run: SensorRunSettings, slips: Sequence[Slip], listen_s: float | None
) -> Mapping[str, Any]:
    """Largest product of the paper in slip, and between pressing and slip; and the frequency that dominates in slip."""
    if not slips:
        return {}
    for slip in slips:
        evidence.covered(run.stream, slip.commanded_s, slip.end_s)
    blocks = paper_blocks(evidence.recording.blocks(run.stream), run.channel, listen_s)
    inside = np.zeros(len(blocks.end_s), bool)
    for slip in slips:
        inside |= (blocks.begin_s >= slip.begin_s) & (blocks.end_s <= slip.end_s)
    before = (blocks.begin_s >= _descent(evidence).end_s) & (blocks.end_s < slips[0].commanded_s)
    # a block with a value that is not finite does not count
    inside &= ~np.isnan(blocks.power)
    before &= ~np.isnan(blocks.power)
    return {
        "peak_product": float(blocks.product[inside].max()) if inside.any() else None,
        "peak_product_before": float(blocks.product[before].max()) if before.any() else None,
        "dominant_hz": float(np.median(blocks.frequency_hz[inside])) if inside.any() else None,
    }


def _stop(evidence: TrialEvidence, settings: RollSlipSettings, run: SensorRunSettings) -> Mapping[str, float]:
    """From the deciding sample to the stop command, and the tool's travel to standstill."""
    halted_s = evidence.entered_s.get("HALTING")
    if halted_s is None:
        return {}
    started = evidence.last(SlipStarted, detector=getattr(run, settings.reflex), t_s=halted_s)
    sent_s = evidence.stop_sent_s(settings.mover, halted_s)
    if started is None or sent_s is None:
        return {}
    found = {"slip_to_stop_s": sent_s - started.t_s}
    still_s = evidence.entered_s.get("STOPPED")
    if still_s is not None:
        poses = evidence.covered(settings.pose_stream, started.t_s, still_s)
        here_m, there_m = np.interp((started.t_s, still_s), poses.times_s, poses.values[:, 0])
        found["stop_travel_m"] = float(abs(there_m - here_m))
    return found
