"""The part of the page on B1 to B5 and B8: slip with five sensors, beside the paper's figures and its Table 1."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from controller.detectors.calibration import poisson_interval
from controller.measures.slip import BLOCK_S, PaperBlocks, paper_blocks
from controller.recording.reader import Run
from controller.recording.series import Series, TrialRecording
from controller.reports.counts import (
    METHODS,
    Row,
    Trials,
    number,
    paired,
    rate,
    tails,
    three,
    under,
    wilson,
)
from controller.reports.figures import FAINT, FALSE, GOOD, INK, OURS, PAPER, Figures
from controller.reports.run_account import recorded, setting_of
from controller.reports.section import UNTOLD, Headline, Kind, Printed, Section, kind_of, rated, told
from controller.reports.slip_scores import (
    GRADES,
    PLAIN,
    SENSORS,
    TABLE_1,
    VERDICTS,
    Condition,
    SensorScore,
    condition_of,
    drawn_in,
    measured_rows,
    read_scores,
)
from controller.scales import NOTHING
from drivers.core.messages import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes


SAME_RATE = 0.01
"""Sample rates nearer than that give one vibration the same power: a block's power grows with its number of samples."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """The comparison table and each sensor's run."""
    scores = read_scores(runs)
    found = dict.fromkeys(score.condition for score in scores)
    conditions = sorted(found, key=lambda each: (each.nuisance != PLAIN, each))
    ids = [paper["id"] for name, paper in SENSORS.items() if any(score.sensor == name for score in scores)]
    plain = [
        score for score in scores if score.condition == TABLE_1 and score.slips and score.method == "paper"
    ]
    content = {
        "ids": ids,
        "verdicts": VERDICTS,
        "plain": plain,
        "kinds": {score.sensor: kind_of(runs, Kind(score.paper["kind"])) for score in plain},
        "better": {
            s.sensor: GRADES.index(s.verdict) > GRADES.index(s.paper["verdict"]) for s in plain if s.decided
        },
        "conditions": [_of_condition(scores, condition) for condition in conditions],
        "frequencies": _frequencies(runs),
        "stops": tails(Trials.of(runs), "slip_to_stop_s", "stop_travel_m"),
        "drawn": list(_draw(runs, figures)),
        "disagreeing": [s.paper["id"] for s in plain if s.decided and s.verdict != s.paper["verdict"]],
        "too_slow": {
            score.paper["id"]: (_thresholds(score, runs), score.least_delay_s)
            for score in scores
            if score.too_slow
        },
    }
    more: dict[str, Any] = {"paper": "fernandez", "printed": _printed(runs[0]), "headline": _headline(scores)}
    return told(runs, f"Slip ({', '.join([*ids, 'B8'])})", "slip", content, **more)


def _headline(scores: Sequence[SensorScore]) -> Headline | None:
    """On how many sensors the paper's detector is as good as in the paper; where the slips decide that of no more than
    half of the sensors, how ours does beside it."""
    plain = [score for score in scores if score.condition == TABLE_1 and score.method == "paper"]
    known = [score for score in plain if score.slips and score.decided]
    if 2 * len(known) <= len(plain):
        return _ours_beside(scores)
    same = sum(score.verdict == score.paper["verdict"] for score in known)

    def counted(verdicts: Sequence[str]) -> str:
        counts = {name: verdicts.count(name) for name in ("good", "regular", "bad")}
        return ", ".join(f"{n} {name}" for name, n in counts.items() if n)

    return Headline(
        f"the paper's detector on {len(known)} sensors, by misses and delay",
        counted([score.verdict for score in known]),
        f"{len(known)} sensors",
        counted([score.paper["verdict"] for score in known]),
        "the paper, Table 1",
        f"agree on {rate(same, len(known))}",
        f"the paper's detector does as in the paper on {same} of {len(known)} sensors",
    )


def _ours_beside(scores: Sequence[SensorScore]) -> Headline | None:
    """Slips that ours detects in time, beside the paper's detector on the same; without slips, both's false alarms."""
    ours, paper = (
        SensorScore(
            "", TABLE_1, method, Trials(row for each in scores if each.method == method for row in each.rows)
        )
        for method in ("ours", "paper")
    )
    alarms = {score.method: score["false_alarms"] for score in (ours, paper)}
    a_minute = {
        score.method: 60.0 * score["false_alarms"] / score.quiet_s for score in (ours, paper) if score.quiet_s
    }
    if n := ours.slips - ours.cut_short:
        hits, of = len(ours.delays_s), paper.slips - paper.cut_short
        theirs = len(paper.delays_s) / of if of else None
        both = ours.rows.known("ours_detected", "paper_detected")
        what = f"slips that our detector detects, within {VERDICTS['missed_after_s']:g} s of their beginning"
        above = paired((row["ours_detected"], row["paper_detected"]) for row in both)
        found = rated(what, hits, n, theirs, SAME_SAMPLES, above=above)
        beside = ""
        if theirs is not None:
            beside = f", {found.side} than" if found.side in ("better", "worse") else ","
            beside += f" the paper's {len(paper.delays_s)} of {of}" + f" ({UNTOLD})" * (not found.side)
        state = "well" if hits == n else "partly" if hits else "badly"
        rates = [
            f"{METHODS[method]} {value:.2g} ({alarms[method]} in all)" if value else f"{METHODS[method]} 0"
            for method, value in a_minute.items()
        ]
        false = f"false alarms a minute: {', '.join(rates) or 'not counted'}"
        verdict = f"our detector detects {hits} of {n} slips{beside}; {false}"
        return found._replace(of=f"{hits} of {n} slips", verdict=verdict, state=state)
    if "ours" not in a_minute:
        return None
    here, there = (f"{three(a_minute[each])} a minute" if each in a_minute else "" for each in alarms)
    low, high = (three(60.0 * end / ours.quiet_s) for end in poisson_interval(alarms["ours"]))
    what = "false alarms of our detector"
    return Headline(
        what,
        here,
        f"{alarms['ours']} in {three(ours.quiet_s)} s",
        there,
        SAME_SAMPLES,
        f"{low} to {high} a minute",
        f"{what}: {here}" + f", the paper's {there}" * bool(there),
        state="partly" if alarms["ours"] else "well",
    )


SAME_SAMPLES = "the paper's detector (same samples)"

# --- tables ------------------------------------------------------------------------------------------


def _of_condition(scores: Sequence[SensorScore], condition: Condition) -> Mapping[str, Any]:
    """Slips, and false alarms, of every sensor and detector under one condition: `With bumps, 1 a second; the arm stops
    when ours detects slip`."""
    own = [score for score in scores if score.condition == condition]
    nuisance = "As in Table 1" if condition.nuisance == PLAIN else f"With {condition.nuisance}"
    reflex = f"; the arm stops when {METHODS.get(condition.reflex)} detects slip" * bool(condition.reflex)
    slips, alarms = [], []
    for score in own:
        named = {"sensor": score.name, "detector": METHODS[score.method]}
        low, high = (number(end, 0, 100.0) for end in wilson(score["missed"], score.scored))
        late_s = float(np.percentile(score.delays_s, 95)) if score.delays_s else None
        of = " (too slow)" * score.too_slow if score.decided else f" (n = {score.scored} of {score.slips})"
        line: Row = {
            **named,
            "early": f"{score['early']} of {score.slips}",
            "missed (95 %)": f"{score['missed']} of {score.scored} ({low} to {high} %)"
            if score.scored
            else NOTHING,
            **under("delay_s", score.median_s, "median", 3),
            **under("delay_s", late_s, "p95", 3),
            "verdict": f"{score.verdict}{of}",
            **({"the paper's": score.paper["verdict"]} if condition == TABLE_1 else {}),
        }
        slips += [line] if score.slips else []
        line = {
            **named,
            "false alarms": score["false_alarms"],
            "in": _minutes(score.quiet_s),
            "mean interval (95 %)": interval(score["false_alarms"], score.quiet_s),
            "at touches": f"{score['touch_alarms']} in {score.touches}" if score.touches else NOTHING,
        }
        alarms.append(line)
    return {
        "table_1": condition == TABLE_1,
        "under": nuisance + reflex,
        "cut": bool(condition.reflex),
        "slips": slips,
        "alarms": alarms,
    }


def interval(alarms: int, quiet_s: float) -> str:
    """`20 min (8 to 61)`: mean time between false alarms and its 95 % interval; `over 4 min` where there was none."""
    if quiet_s <= 0.0:
        return NOTHING
    low, high = poisson_interval(alarms)
    if alarms == 0:
        return f"over {_minutes(quiet_s / high)}"
    return f"{_minutes(quiet_s / alarms)} ({_minutes(quiet_s / high)} to {_minutes(quiet_s / low)})"


def _minutes(seconds: float) -> str:
    if seconds < 120.0:
        return f"{number(seconds, 0 if seconds >= 10.0 else 1)} s"
    return f"{number(seconds / 60.0, 0)} min"


def _frequencies(runs: Sequence[Run]) -> list[Row]:
    found: list[Row] = []
    shown = "none stands out"
    for sensor, paper in SENSORS.items():
        rows = Trials(
            row
            for run in runs
            for row in measured_rows(run)
            if row.get("sensor") == sensor and condition_of(run, row).nuisance == PLAIN
        )
        if not rows:
            continue
        unit, factor, comparable = _signal_scale(runs, sensor)
        product, before = (rows.median(name) for name in ("peak_product", "peak_product_before"))
        printed = number(paper["dominant_hz"], 0) if paper["dominant_hz"] else shown
        found.append(
            {
                "sensor": f"{paper['id']} {paper['name']}",
                **under("dominant_hz", rows.median("dominant_hz"), "in slip"),
                **under("paper_hz", printed, "the paper"),
                "product": {
                    "unit": f"{unit}² Hz",
                    **under("product", product and product * factor**2, "in slip"),
                    **under("product", before and before * factor**2, "before"),
                    "the paper": paper["product"],
                    "comparable": comparable,
                },
                **under("press_n", rows.median("press_n"), "pressed with"),
            }
        )
    return found


def _signal_scale(runs: Sequence[Run], sensor: str) -> tuple[str, float, str]:
    """Unit that a signal is shown in, the factor to it, and whether the product's scale is the paper's."""
    paper = SENSORS[sensor]
    run, _, recording = next(_drawable(runs, sensor), (None, None, None))
    if run is None or recording is None:
        return "signal", 1.0, "unknown: no trial in slip is recorded"
    series = recording.stream(str(setting_of(run, "behavior", "sensors", sensor, "stream")))
    rate_hz = series.rate_hz if len(series) > 1 else paper["rate_hz"]
    unit, factor = drawn_in(sensor, series.unit)
    if unit != paper["signal"]:
        return unit, factor, f"no: the paper's signal is in {paper['signal']}"
    if abs(rate_hz / paper["rate_hz"] - 1.0) > SAME_RATE:
        return unit, factor, f"no: {rate_hz:.0f} Hz here, the paper {paper['rate_hz']:.0f} Hz"
    return unit, factor, "yes"


def _printed(run: Run) -> Mapping[str, Printed]:
    """What the paper prints of its detector on each sensor of a profile, by the path of the setting."""
    found: dict[str, Printed] = {}
    for sensor, settings in (setting_of(run, "behavior", "sensors") or {}).items():
        paper = SENSORS.get(sensor)
        name = settings.get("paper") if isinstance(settings, Mapping) else None
        if paper is not None and setting_of(run, "detectors", str(name)):
            threshold = "not printed" if paper["threshold"] is None else paper["threshold"]
            found[f"detectors.{name}.block_s"] = Printed(paper["block_s"], f"{paper['source']:g}")
            found[f"detectors.{name}.threshold"] = Printed(threshold, f"{paper['source']:g}")
    return found


def _thresholds(score: SensorScore, runs: Sequence[Run]) -> list[float]:
    """Of our detector on a sensor."""
    names = {setting_of(run, "behavior", "sensors", score.sensor, "ours") for run in runs}
    found = {setting_of(run, "detectors", str(name), "threshold") for run in runs for name in names}
    return [value for value in found if isinstance(value, int | float)]


# --- figures -----------------------------------------------------------------------------------------


def _draw(runs: Sequence[Run], figures: Figures) -> Iterator[tuple[str, str]]:
    """One figure a sensor, from its first recorded trial without other nuisance, and the fingertip's spectra."""
    for sensor in SENSORS:
        for drawn in islice(_drawable(runs, sensor), 1):
            yield sensor, draw_run(figures, *drawn, sensor)
            yield "spectra", draw_fingertip_spectra(figures, *drawn) if sensor == "fingertip" else ""


def _drawable(runs: Sequence[Run], sensor: str) -> Iterator[tuple[Run, Row, TrialRecording]]:
    for run, row, recording in recorded(runs):
        plain = row.get("sensor") == sensor and condition_of(run, row).nuisance == PLAIN
        if plain and row.get("outcome") == "contact" and row.get("slips"):
            yield run, row, recording


def draw_run(figures: Figures, run: Run, row: Row, recording: TrialRecording, sensor: str) -> str:
    """One trial: the signal (forces and angle of a fingertip), peak and frequency of each block, their product; ""
    where it was not recorded."""
    settings = setting_of(run, "behavior", "sensors", sensor) or {}
    stream, channel = str(settings.get("stream")), settings.get("channel")
    zero_s = float(row.get("clock_s") or 0.0)
    # Lifting off shakes the tip as nothing else does: it is not part of the paper's runs.
    own = run.events_of(row["trial"])
    lifted_s = next((float(event["t_s"]) for event in own if event.get("next") == "LIFTING"), np.inf)
    series = recording.stream(stream).between(zero_s, lifted_s)
    if len(series) < 2:
        return ""
    forces = recording.stream(str(settings.get("forces_stream") or "")).between(zero_s, lifted_s)
    blocks = paper_blocks(recording.blocks(stream), channel, row.get("listen_s"))
    shown = (blocks.begin_s >= zero_s) & (blocks.end_s < lifted_s)
    blocks = PaperBlocks(*(column[shown] for column in blocks))
    unit, factor = drawn_in(sensor, series.unit)
    panels = 5 if len(forces) else 4
    with figures.figure(1.15 * panels + 0.6, rows=panels, sharex=True) as drawing:
        axes = drawing.axes
        if len(forces):
            _draw_forces(axes[0], axes[1], forces, zero_s)
        else:  # the channel that slip is looked for in; of many the one that is loaded most
            column = int(np.argmax(series.values.mean(axis=0))) if channel is None else channel
            axes[0].plot(series.times_s - zero_s, factor * series.values[:, column], color=INK, lw=0.6)
            axes[0].set_ylabel(f"signal ({unit})")
        products = factor**2 * blocks.product
        for panel, values, label in (
            (axes[-3], factor**2 * blocks.power, f"peak ({unit}²)"),
            (axes[-2], blocks.frequency_hz, "frequency (Hz)"),
            (axes[-1], products, f"product ({unit}² Hz)"),
        ):
            panel.step(*_broken(blocks, values, zero_s), where="pre", color=OURS, lw=0.8)
            panel.set_ylabel(label)
        threshold = setting_of(run, "detectors", str(settings.get("paper")), "threshold")
        if isinstance(threshold, int | float):
            axes[-1].axhline(factor**2 * threshold, color=FALSE, lw=0.8, ls=(0, (4, 2)))
        top = 1.1 * float(np.nanmax(products, initial=0.0))
        looks: Mapping[Any, Any] = {
            settings.get("ours"): {"marker": "o", "mfc": "none", "color": GOOD},
            settings.get("paper"): {"marker": "x", "color": FALSE},
        }
        for event in own:
            if event.get("event") == "SlipStarted" and event.get("detector") in looks:
                look = looks[event["detector"]]
                axes[-1].plot(float(event["t_s"]) - zero_s, top, ms=4.0, ls="none", clip_on=False, **look)
        for panel in axes:
            if row.get("slip_s") is not None and row.get("slip_end_s") is not None:
                slip = row["slip_s"] - zero_s, row["slip_end_s"] - zero_s
                panel.axvspan(*slip, color=FAINT, alpha=0.35, lw=0)
            panel.set_xlim(left=max(0.0, float(series.times_s[0]) - zero_s))
        axes[-1].set_xlabel("time (s)")
        drawing.figure.align_ylabels()
        return drawing.save(f"slip_{sensor}")


def draw_fingertip_spectra(figures: Figures, run: Run, row: Row, recording: TrialRecording) -> str:
    """Fig. 9: the spectrum of one block of Ft before contact, while it rolls, while it slips and at rest after it; ""
    where it was not recorded."""
    settings = setting_of(run, "behavior", "sensors", "fingertip") or {}
    slip_s, end_s, touch_s = row.get("slip_s"), row.get("slip_end_s"), row.get("touch_s")
    if slip_s is None or end_s is None or touch_s is None:
        return ""
    series = recording.stream(str(settings.get("stream")))
    if len(series) < 2:
        return ""
    rate_hz = series.rate_hz
    size = round(BLOCK_S * rate_hz)
    instants = {
        "before contact": touch_s - 0.3,
        "rolling": 0.5 * (touch_s + slip_s),
        "slipping": 0.5 * (slip_s + end_s),
        "at rest": end_s + 1.0,
    }
    with figures.panels(4, 2, 1.55, sharex=True) as drawing:
        for axes, (name, at_s) in zip(drawing.axes, instants.items(), strict=True):
            first = int(np.searchsorted(series.times_s, at_s))
            block = series.values[first : first + size, int(settings.get("channel") or 0)]
            if len(block) < size:
                continue
            power = np.abs(np.fft.rfft(block)[1:]) ** 2 / size
            axes.vlines(np.arange(1, len(power) + 1) * rate_hz / size, 0.0, power, color=OURS, lw=1.4)
            axes.set_ylim(bottom=0.0)
            axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3))
            axes.set_title(f"{name}, t = {at_s - float(row.get('clock_s') or 0.0):.1f} s")
        drawing.label_outside("frequency (Hz)", f"power ({series.unit}²)")
        return drawing.save("fig_9_spectra")


def _broken(blocks: PaperBlocks, values: Floats, zero_s: float) -> tuple[Floats, Floats]:
    """Ends of blocks and values, with a NaN at the beginning of each block that does not follow on the one before."""
    # half a block is longer than rounding and shorter than any gap that makes a new block matter
    half_s = 0.5 * (blocks.end_s - blocks.begin_s)[1:]
    apart = np.flatnonzero(blocks.begin_s[1:] - blocks.end_s[:-1] > half_s) + 1
    return np.insert(blocks.end_s, apart, blocks.begin_s[apart]) - zero_s, np.insert(values, apart, np.nan)


def _draw_forces(forces: Axes, angle: Axes, series: Series, zero_s: float) -> None:
    """Fig. 8a and 11: Fx, Fy, Ft, and below Fn with theta."""
    times_s = series.times_s - zero_s
    looks = (("Fx", PAPER), ("Fy", FAINT), ("Ft", OURS))
    for column, (name, color) in zip(series.values[:, :3].T, looks, strict=True):
        forces.plot(times_s, column, color=color, lw=0.8, label=name)
    forces.set_ylabel("force (N)")
    forces.legend(ncols=3, loc="upper right")
    angle.plot(times_s, series.values[:, 3], color=INK, lw=0.8, label="Fn")
    angle.set_ylabel("Fn (N)")
    pressed = series.values[:, 3] > 0.5
    theta = np.where(pressed, np.degrees(series.values[:, 4]), np.nan)
    other = angle.twinx()
    other.plot(times_s, theta, color=GOOD, lw=0.8)
    other.set_ylabel("θ (°)", color=GOOD)
    other.spines["right"].set_visible(True)
