"""Synthetic runs, written by the real recorder: what a report is fed in these tests."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from behaviors.events import BaselineReady, Contact, GuardStopped
from controller.recording.reader import Run, open_run
from controller.recording.recorder import Recorder
from controller.recording.run_folder import RunFolder
from drivers.core.messages import SampleBlock, Stop, StreamInfo

START = datetime(2026, 11, 20, 12, 0, 0, tzinfo=UTC)
STREAMS = {
    "board.load_cell": StreamInfo("board.load_cell", ("force",), "N", 1e-6, 1000.0),
    "board.accelerometer": StreamInfo("board.accelerometer", ("z",), "m/s2", 1e-3, 1000.0),
    "board.period": StreamInfo("board.period", ("period",), "s", 1e-6),
    "stage.position": StreamInfo("stage.position", ("position",), "m", 1e-7, 100.0),
}
MEASURES = [
    *("truth_contact_s", "onset_s", "detect_s", "delay_s", "extent_m", "force_n", "force_peak_n"),
    *("false_contacts", "baseline_hz", "threshold_hz", "command_s", "standstill_s", "stop_travel_m"),
]
STATIC = ["frequency_hz", "frequency_sd_hz", "amplitude_m_s2", "amplitude_m", "force_n", "force_peak_n"]
ONSET_S, APPROACH_S, BASELINE_S = 94.0, 93.0, 91.0


@dataclass(frozen=True)
class Given:
    """An approach to be written: its factors and what was measured of it."""

    location: str = "f"
    speed_m_s: float = 0.004843
    delay_s: float | None = 0.2
    """From onset; None of a contact: the load cell shows no onset."""

    force_n: float | None = 0.05
    outcome: str = "contact"
    noise_scale: float | None = None
    sample_hz: float | None = None
    observer_s: float | None = None
    """When the detector `observer` detects contact, from onset; None: never."""


def begun(
    root: Path, experiment: str, bench: str, resolved: Mapping[str, object], **more: object
) -> RunFolder:
    """A run's folder and manifest; `more` is laid over the manifest."""
    folder = RunFolder.create(root, f"{bench}/{experiment}", START)
    folder.write_manifest(
        {
            "profile": {"name": f"{bench}/{experiment}", "hash": "0123456789abcdef", "resolved": resolved},
            "experiment": experiment,
            "bench": bench,
            "started_utc": START.isoformat(),
            "exit": {"status": "done", "code": 0, "reason": ""},
            **more,
        }
    )
    return folder


def write_rows(
    folder: RunFolder,
    rows: Iterable[tuple[Mapping[str, object], str, Mapping[str, object]]],
    measures: Iterable[str],
) -> Run:
    """A run whose trials are these: factors, outcome and what was measured; nothing is recorded of them."""
    rows = list(rows)
    factors = list(dict.fromkeys(name for each, _, _ in rows for name in each))
    recorder = Recorder(folder, START, streams={}, factors=factors, measures=list(measures))
    for trial, (given, outcome, row) in enumerate(rows, start=1):
        recorder.begin_trial(trial, {name: given.get(name) for name in factors}, 100.0 * trial)
        recorder.end_trial(outcome, dict(row))
    recorder.close()
    return open_run(folder.path)


def backus(
    root: Path, experiment: str, bench: str, status: str = "done", settle_s: float = 90.0
) -> RunFolder:
    """A run with the paper's detector."""
    papers = {"kind": "resonance.paper", "average_samples": 10, "sample_hz": 15.0, "baseline_s": 1.0}
    behavior, detectors = {"settle_s": settle_s}, {"contact": papers}
    resolved = {"title": "A <title>", "behavior": behavior, "detectors": detectors}
    exit_ = {"status": status, "code": 0, "reason": ""}
    clock = "wall" if bench == "hardware" else "virtual"
    return begun(root, experiment, bench, resolved, exit=exit_, clock=clock)


def block(stream: str, times_s: np.ndarray, values: np.ndarray) -> SampleBlock:
    info = STREAMS[stream]
    raw = np.round(values / info.scale).astype(np.int32).reshape(-1, 1)
    irregular = None if info.rate_hz else times_s
    return SampleBlock(stream, 0, float(times_s[0]), raw, info.rate_hz, irregular, info.unit, info.scale)


def periods(
    end_s: float, frequency_hz: float, wander_hz: float, rng: np.random.Generator
) -> tuple[np.ndarray, ...]:
    """Periods from BASELINE_S on: a steady frequency before onset, 2 Hz more each tenth of a second after."""
    times, lengths, t_s = [], [], BASELINE_S
    while t_s < end_s:
        rise_hz = min(20.0 * max(0.0, t_s - ONSET_S), 15.0)
        lengths.append(1.0 / (frequency_hz + rise_hz + wander_hz * rng.normal()))
        t_s += lengths[-1]
        times.append(t_s)
    return np.array(times), np.array(lengths)


def write_approach(recorder: Recorder, trial: int, given: Given, offset_s: float) -> None:
    rng = np.random.default_rng(trial)
    factors = {"location": given.location, "speed_m_s": given.speed_m_s}
    if given.noise_scale is not None:
        factors |= {"plant.noise_scale": given.noise_scale, "detectors.contact.sample_hz": given.sample_hz}
    recorder.begin_trial(trial, factors, offset_s)
    recorder.skip("board.load_cell", 0.0, BASELINE_S)
    row: dict[str, object] = {"truth_contact_s": ONSET_S - 0.01, "baseline_hz": 28.0, "threshold_hz": 28.6}
    row |= {"force_peak_n": 0.08, "false_contacts": 0, "onset_s": ONSET_S}
    detect_s = ONSET_S + given.delay_s if given.delay_s is not None else None
    if given.outcome == "false_contact":
        detect_s = ONSET_S - 0.5
        row |= {"false_contacts": 1, "detect_s": detect_s, "onset_s": None, "truth_contact_s": None}
    elif given.outcome == "contact" and given.delay_s is None:  # a real load cell that shows no onset
        detect_s = ONSET_S + 0.2
        row |= {"false_contacts": None, "detect_s": detect_s, "onset_s": None, "truth_contact_s": None}
    elif given.outcome == "contact":
        row |= {"detect_s": detect_s, "delay_s": given.delay_s, "force_n": given.force_n}
        row["extent_m"] = given.speed_m_s * given.delay_s
    recorder.event(BaselineReady(APPROACH_S, "contact", 28.0, 28.6), state="BASELINE", next_state="APPROACH")
    if given.observer_s is not None:
        recorder.event(BaselineReady(APPROACH_S, "observer", 28.0, 29.0), state="APPROACH")
        recorder.event(Contact(ONSET_S + given.observer_s, "observer", 29.1, 29.0), state="APPROACH")
    if given.outcome == "guard":
        recorder.event(GuardStopped(93.5, "force 2.1 N above 2 N"), state="APPROACH", next_state="FAILED")
    if detect_s is not None and "detect_s" in row:
        row |= {"command_s": detect_s + 0.005, "standstill_s": detect_s + 0.03, "stop_travel_m": 0.0001}
        found = Contact(detect_s, "contact", 28.7, 28.6)
        recorder.event(found, state="APPROACH", next_state="STOPPING", commands=[Stop("stage")])
    times_s = np.arange(BASELINE_S, (detect_s or ONSET_S) + 0.4, 1e-3)
    push_m = np.clip((times_s - ONSET_S) * given.speed_m_s, 0.0, None)
    force_n = 0.01 + 40.0 * push_m * (1.0 + 0.4 * np.sin(2 * np.pi * 28.0 * times_s))
    force_n += 2e-4 * rng.normal(size=len(push_m))
    recorder.record([block("board.load_cell", times_s, force_n)])
    recorder.record([block("board.period", *periods(times_s[-1], 28.0, 0.15, rng))])
    recorder.end_trial(given.outcome, row)


def write_transient(
    root: Path,
    approaches: Sequence[Given],
    *,
    bench: str = "mock",
    status: str = "done",
    settle_s: float = 90.0,
    order: Iterable[int] | None = None,
) -> Run:
    factors = ["location", "speed_m_s"]
    if any(each.noise_scale is not None for each in approaches):
        factors += ["plant.noise_scale", "detectors.contact.sample_hz"]
    folder = backus(root, "transient", bench, status, settle_s)
    recorder = Recorder(folder, START, streams=STREAMS, factors=factors, measures=MEASURES)
    for place, trial in enumerate(order or range(1, len(approaches) + 1)):
        write_approach(recorder, trial, approaches[trial - 1], 100.0 * place)
    recorder.close()
    return open_run(folder.path)


def write_static(
    root: Path, frequencies_hz: dict[str, float], *, bench: str = "mock", repeats: int = 1
) -> Run:
    folder = backus(root, "static", bench)
    recorder = Recorder(folder, START, streams=STREAMS, factors=["condition"], measures=STATIC)
    times_s = np.arange(100.0, 102.0, 1e-3)
    amplitudes = {"none": 12.0, "light": 9.0, "full": 6.0}
    for trial, (condition, frequency_hz) in enumerate([*frequencies_hz.items()] * repeats, start=1):
        recorder.begin_trial(trial, {"condition": condition}, 110.0 * trial)
        wave = amplitudes[condition] * np.sin(2 * np.pi * frequency_hz * times_s)
        noise = {"none": 0.1, "light": 1.5, "full": 0.2}[condition]
        wave += noise * np.random.default_rng(trial).normal(size=2000)
        recorder.record([block("board.accelerometer", times_s, wave)])
        row = {
            "frequency_hz": frequency_hz,
            "frequency_sd_hz": {"none": 0.1, "light": 2.0, "full": 0.3}[condition],
            "amplitude_m_s2": amplitudes[condition],
            "amplitude_m": amplitudes[condition] / (2 * np.pi * frequency_hz) ** 2,
            "force_n": {"none": 0.0, "light": 0.1, "full": 0.6}[condition],
            "force_peak_n": {"none": 0.0, "light": 0.3, "full": 0.8}[condition],
        }
        recorder.end_trial("recorded", row)
    recorder.close()
    return open_run(folder.path)


def text_of(path):
    """The page's text, without figures and markup."""
    whole = path.read_text("utf-8").replace("<wbr>", "")
    page = re.sub(r"<(svg|style|script)\b.*?</\1>", " ", whole, flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page)).replace("\u2019", "'")
