"""The section on B1 to B5 and B8, from rows written by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from controller.measures.slip import COLUMNS
from controller.recording.reader import Run
from controller.recording.series import Series
from controller.reports import slip
from controller.reports.figures import Figures
from controller.reports.report import build_report
from controller.reports.slip import interval
from controller.reports.slip_scores import (
    NOT_DECIDED,
    NOT_JUDGED,
    PLAIN,
    PLANT,
    SENSORS,
    TABLE_1,
    condition_of,
    read_scores,
    verdict_of,
)
from simulator.physics.fingertip_settings import SlipBenchSettings
from tests.unit.controller.reports.synthetic_runs import begun, text_of, write_rows

NEVER = float("inf")


def trial(sensor="fingertip", outcome="contact", slips=1, **more):
    """A trial in which both detectors found every slip, but for the cells given as `paper_…` and `ours_…`."""
    row = {"slips": slips, "touch_s": 3.5, "listen_s": 1.0}
    for method in ("paper", "ours"):
        row |= {f"{method}_{what}": 0 for what in ("missed", "early", "false_alarms", "touch_alarms")}
        row |= {f"{method}_detected": slips, f"{method}_quiet_s": 100.0}
        row |= {f"{method}_delay_s": 0.05 if slips else None}
    return sensor, outcome, {**row, **more}


UNDETECTED = {"detected": 0, "delay_s": None}


def of(method, **what):
    return {f"{method}_{name}": value for name, value in what.items()}


def write(root, trials, *, factors=("sensor",), planned=None, bench="mock", **resolved):
    plant = {key: usual for key, (usual, _) in PLANT.items()} | resolved.pop("plant", {})
    nuisances = {key.removeprefix("nuisances."): plant.pop(key) for key in list(plant) if "." in key}
    settings = {
        "plant": {**plant, "nuisances": nuisances},
        "behavior": {"stop_on_slip": False, "reflex": "ours", **resolved.pop("behavior", {})},
        **resolved,
    }
    folder = begun(root, "slip", bench, settings, trials=planned or len(trials))
    rows = []
    for sensor, outcome, row in trials:
        given = {"sensor": sensor, **{name: row[name] for name in factors if name in row}}
        rows.append((given, outcome, {name: row[name] for name in row if name not in factors}))
    return write_rows(folder, rows, COLUMNS)


def scores_of(*runs):
    return {(each.sensor, each.condition, each.method): each for each in read_scores(runs)}


def test_slips_that_were_called_early_are_neither_detected_nor_missed(tmp_path):
    early = [trial(**of("paper", early=1, **UNDETECTED))] * 5
    score = scores_of(write(tmp_path, [trial(), *early]))["fingertip", TABLE_1, "paper"]
    assert (score.slips, score.scored, score["early"], score.cut_short) == (6, 1, 5, 0)
    assert score.verdict == NOT_DECIDED, "one slip of six is no evidence"


def test_text_for_numbers_counts_as_no_number(tmp_path, undrawn):
    spoiled = dict.fromkeys(trial()[2], "abc")
    run = write(tmp_path, [trial(), trial(**spoiled | {"slips": 1})])
    score = scores_of(run)["fingertip", TABLE_1, "ours"]
    assert (score.slips, score["missed"], score.quiet_s, list(score.delays_s)) == (2, 0, 100.0, [0.05])
    assert "B1 fingertip ours 0 of 2" in text_of(build_report([run]))


def test_a_share_missed_is_one_of_those_detected_or_missed(tmp_path, undrawn):
    rows = [
        *[trial()] * 72,
        *[trial(**of("paper", missed=1, **UNDETECTED))] * 8,
        *[trial(**of("paper", early=1, **UNDETECTED))] * 80,
    ]
    run = write(tmp_path, rows)
    # 8 of 80 are regular for sure, 8 of 160 might be good: but of these 80 were never there to be missed
    assert scores_of(run)["fingertip", TABLE_1, "paper"].verdict == "regular"
    text = text_of(build_report([run]))
    assert "B1 fingertip the paper's 80 of 160 8 of 80 (5 to 19 %) 0.050 0.050 regular good" in text
    assert "regular; the paper says good; beside that, 80 of 160 slips were called before they began." in text


def test_a_detector_that_was_never_given_its_time_is_not_judged(tmp_path, undrawn):
    cut = [trial(**of("paper", **UNDETECTED))] * 3
    run = write(tmp_path, cut)
    assert scores_of(run)["fingertip", TABLE_1, "paper"].cut_short == 3
    text = text_of(build_report([run]))
    assert "none detected: no grade; the paper says good: not decided with n = 0." in text
    assert "not decided (n = 0 of 3)" in text
    assert "Not at equal false alarms" in text


def test_with_the_reflex_the_other_detector_has_no_verdict_whatever_it_detected(tmp_path, undrawn):
    run = write(tmp_path, [trial()] * 75, behavior={"stop_on_slip": True})
    stopped = condition_of(run, run.trials[0])
    assert (stopped.nuisance, stopped.reflex) == (PLAIN, "ours")
    scores = scores_of(run)
    assert scores["fingertip", stopped, "paper"].verdict == NOT_JUDGED
    assert scores["fingertip", stopped, "ours"].verdict == "good"
    text = text_of(build_report([run]))
    assert "As in Table 1; the arm stops when ours detects slip: columns as in Table 1" in text
    assert "not judged" in text
    assert "the paper says" not in text


@pytest.mark.parametrize("outcome", ["guard", "fault", "aborted", "no_contact"])
def test_trials_that_did_not_run_to_their_end_are_left_out(tmp_path, outcome):
    cut = trial(outcome=outcome, **of("paper", missed=1, **UNDETECTED))
    score = scores_of(write(tmp_path, [*[trial()] * 75, cut]))["fingertip", TABLE_1, "paper"]
    assert (score.slips, score["missed"], score.verdict) == (75, 0, "good")


@pytest.mark.parametrize(
    ("key", "value", "nuisance"),
    [
        ("rolling_scale", 2.0, "rolling × 2"),
        ("noise_scale", 3.0, "noise × 3"),
        ("mode_scale", 0.7, "frequency × 0.7"),
        ("damping_scale", 3.0, "damping × 3"),
        ("friction", 0.4, "friction 0.4"),
        ("bumps_hz", 1.0, "bumps, 1 a second"),
        ("loads_hz", 0.5, "load steps, 0.5 a second"),
        ("nuisances.hum", 3.0, "hum of 3 noise"),
    ],
)
def test_another_bench_is_not_table_1_be_it_the_profiles_or_the_trials(tmp_path, key, value, nuisance):
    profile = write(tmp_path, [trial()], plant={key: value})
    assert condition_of(profile, profile.trials[0]).nuisance == nuisance
    usual = PLANT[key][0]
    usual = 0.2 if usual == "none" else usual
    factor = f"plant.{key}"
    each = write(tmp_path, [trial(**{factor: value})], factors=("sensor", factor))
    assert condition_of(each, each.trials[0]).nuisance == nuisance
    if key != "friction":
        back = write(tmp_path, [trial(**{factor: usual})], factors=("sensor", factor), plant={key: value})
        assert condition_of(back, back.trials[0]).nuisance == PLAIN, "the trial's own setting counts"


def test_every_setting_of_the_bench_is_compared_with_its_default_and_a_threshold_with_the_profiles(tmp_path):
    fields = {name: field.default for name, field in SlipBenchSettings.model_fields.items()}
    assert fields.pop("surface_m") == 0.003, "where the table lies: when, not what"
    nuisances = fields.pop("nuisances").model_dump()
    for shape in ("change_s", "hum_hz", "tremor_hz", "bounce_s", "bounce_ratio"):
        assert nuisances.pop(shape), "how a nuisance comes, not how strong it is"
    fields |= {f"nuisances.{name}": value for name, value in nuisances.items()}
    assert {key: "none" if value is None else value for key, value in fields.items()} == {
        key: usual for key, (usual, _) in PLANT.items()
    }
    factor = "detectors.fingertip_ours.threshold"
    run = write(tmp_path, [trial(**{factor: 30.0})], factors=("sensor", factor))
    assert condition_of(run, run.trials[0]).nuisance == "detectors.fingertip_ours.threshold = 30"


def test_what_bumps_do_stands_in_a_table_of_its_own(tmp_path, undrawn):
    shaken = [trial(**of("paper", false_alarms=2, touch_alarms=1)), *[trial()] * 2]
    runs = [write(tmp_path, [trial()] * 3), write(tmp_path, shaken, plant={"bumps_hz": 1.0})]
    text = text_of(build_report(runs))
    assert "With bumps, 1 a second: columns as in Table 1, thresholds as in the profile." in text
    # 300 s: two alarms are 150 s apart, 300 / 7.22 to 300 / 0.242 s (Garwood's table); none is 300 / 3.69 at least
    assert "B1 fingertip the paper's 2 5 min 2 min (42 s to 21 min) 1 in 3" in text
    assert "B1 fingertip ours 0 5 min over 81 s 0 in 3" in text


BUMPS = {"plant": {"nuisances.bumps_hz": 1.0}}


def test_where_nothing_is_judged_it_opens_with_the_slips_that_ours_detects_beside_the_papers(tmp_path):
    lost = {**of("ours", missed=1, **UNDETECTED), **of("paper", early=1, **UNDETECTED)}
    trials = [trial(), trial(**of("paper", missed=1, **UNDETECTED)), trial("wrist", **lost)]
    found = slip.section([write(tmp_path, trials, **BUMPS)], Figures(tmp_path)).headline
    assert (found.ours, found.of, found.paper, found.state) == ("66.7 %", "2 of 3 slips", "33.3 %", "partly")
    assert found.verdict.startswith(
        "our detector detects 2 of 3 slips, the paper's 1 of 3 (too few to tell apart); false alarms a minute: ours 0,"
    )


def test_it_opens_with_the_papers_table_only_where_slips_decide_that_of_most_sensors(tmp_path):
    bad = of("paper", missed=1, **UNDETECTED)
    decided = [trial("wrist", **bad)] * 75
    shown = slip.section([write(tmp_path / "one", decided)], Figures(tmp_path)).headline
    assert "as in the paper on 1 of 1 sensors" in shown.verdict
    shown = slip.section([write(tmp_path / "two", [*decided, trial()])], Figures(tmp_path)).headline
    assert (shown.of, shown.state) == ("76 of 76 slips", "well")


def test_without_a_slip_it_opens_with_false_alarms_a_minute(tmp_path):
    alarm = of("paper", false_alarms=5)
    calm = [trial(slips=0, **alarm, **of("ours", false_alarms=n)) for n in (0, 1)]
    found = slip.section([write(tmp_path, calm, **BUMPS)], Figures(tmp_path)).headline
    assert (found.ours, found.paper, found.of) == ("0.3 a minute", "3 a minute", "1 in 200 s")
    assert found.interval == "0.0076 to 1.67 a minute", "Poisson of 1: 0.0253 to 5.57, in 200 s"
    assert found.state == "partly"


def test_a_detector_that_did_not_listen_at_the_touch_has_no_alarms_there_and_none_has_a_lower_end(tmp_path):
    score = scores_of(write(tmp_path, [trial(listen_s=5.0)]))["fingertip", TABLE_1, "ours"]
    assert score.touches == 0
    assert interval(0, 3600.0) == "over 16 min", "3600 / 3.69"
    assert interval(0, 0.0) == "–"


def test_a_detector_that_cannot_be_in_time_is_reported(tmp_path, undrawn):
    late = trial("dsa", ours_least_delay_s=2.35, **of("ours", missed=1, **UNDETECTED))
    behavior = {"sensors": {"dsa": {"ours": "dsa_ours"}}}
    detectors = {"dsa_ours": {"threshold": 800.0}}
    text = text_of(build_report([write(tmp_path, [late] * 3, behavior=behavior, detectors=detectors)]))
    assert "bad (too slow)" in text
    assert "B5: at its threshold (800 nats) ours takes at least 2.35 s" in text
    in_time = [trial("dsa", ours_least_delay_s=0.2, **of("ours", missed=1, **UNDETECTED))] * 3
    assert "too slow" not in text_of(build_report([write(tmp_path, in_time)]))


@pytest.mark.parametrize(
    ("delays_s", "grade"),
    [
        ([], NOT_DECIDED),
        ([0.1] * 72, NOT_DECIDED),  # none missed of 72: up to 5.07 % (Wilson)
        ([0.1] * 73, "good"),  # of 73: 4.998 %
        ([0.1] * 72 + [NEVER] * 8, "regular"),
        ([0.1] * 65 + [NEVER] * 15, NOT_DECIDED),  # 12 to 29 %
        ([0.2] * 16, "regular"),
        ([NEVER] * 3, "bad"),
        ([0.1, NEVER, NEVER], "bad"),  # 21 % at the least
        ([0.3] * 5, NOT_DECIDED),  # a median has no interval yet
        ([0.3] * 6, "bad"),
        ([0.1] * 50 + [0.13] * 30, "good"),
        ([0.1] * 42 + [0.13] * 38, NOT_DECIDED),  # ranks 31 and 50 of 80 hold the median
    ],
)
def test_a_verdict_is_what_both_ends_of_the_intervals_say(delays_s, grade):
    assert verdict_of(delays_s) == grade


UNITS = [("dsa", "V", "mV", 1e3), ("fingertip", "V", "V", 1.0), ("barrett_finger", "N", "N", 1.0)]


@pytest.mark.parametrize(("sensor", "unit", "shown", "factor"), UNITS)
def test_the_product_is_in_the_unit_that_the_paper_draws_or_said_not_to_compare(
    tmp_path, undrawn, monkeypatch, sensor, unit, shown, factor
):
    times_s = np.arange(200) / SENSORS[sensor]["rate_hz"]
    series = Series(times_s, np.zeros((200, 1)), unit)
    run = write(tmp_path, [trial(sensor, peak_product=0.0025, peak_product_before=0.001)])
    monkeypatch.setattr(Run, "recorded_trials", [1])
    monkeypatch.setattr(Run, "readable", lambda *_: SimpleNamespace(stream=lambda _: series))
    (row,) = slip._frequencies([run])
    product = row["product"]
    assert product["unit"] == f"{shown}² Hz"
    assert float(product["in slip"]) == pytest.approx(0.0025 * factor**2)
    assert (product["comparable"] == "yes") == (shown == SENSORS[sensor]["signal"])
    assert product["the paper"] == SENSORS[sensor]["product"]
