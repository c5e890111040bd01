"""Sections on C2 to C5, from rows whose sums are made by hand."""

import re

import pytest

from behaviors.search import SearchFactors
from controller.measures import aura as aura_measures
from controller.measures import centering as centering_measures
from controller.reports import aura, centering
from controller.reports.counts import missing
from controller.reports.figures import Figures
from controller.reports.report import build_report
from controller.reports.section import Kind, Result
from tests.unit.controller.reports.synthetic_runs import begun, text_of, write_rows

pytestmark = pytest.mark.usefixtures("undrawn")


def write(root, experiment, rows, *, bench="mock", behavior=None, planned=None):
    """A run whose trials are these rows: factors, measures and, where it is not `approached`, the outcome."""
    measures = {"aura": aura_measures, "centering": centering_measures}[experiment].COLUMNS
    more = {"trials": len(rows) if planned is None else planned, "loss": {"audio.fingers": 7}}
    factors = list(dict.fromkeys(name for row in rows for name in row if name not in (*measures, "outcome")))
    trials = []
    for row in rows:
        measured = {name: row[name] for name in row if name in measures}
        trials.append(({name: row.get(name) for name in factors}, row.get("outcome", "approached"), measured))
    return write_rows(begun(root, experiment, bench, {"behavior": behavior or {}}, **more), trials, measures)


def section_of(module, *runs):
    return module.section(runs, Figures(runs[0].folder.path / "figures"))


def touching(root, rows, **how):
    """The section on contact of approaches that are to touch."""
    return section_of(aura, write(root, "aura", rows, **{"behavior": {"touch": True}, **how}))


def table(section, name, *heads):
    """Cells of a table under some headings, by its first cell and the detector; None for one that is not there."""
    return {
        (row[next(iter(row))], row["detector"]): [
            None if head not in row else str(row[head]) for head in heads
        ]
        for row in section.content[name]
    }


# --- C2, C4, C5 --------------------------------------------------------------------------------------


def approached(**cells):
    """One approach that pre-touch of both saw, and that came to a touch which ours alone felt."""
    row = {"side": "normal", "object": "pipe", "speed_m_s": 0.01, "approaches": 1, "touches": 1}
    for method, felt in (("paper", 0), ("ours", 1)):
        row |= {f"alarms_{method}": 0, f"seen_{method}": 1, f"distance_m_{method}": 0.02}
        row |= {f"felt_{method}": felt, f"false_{method}": 0, f"held_{method}": felt, f"ended_{method}": felt}
        row |= {f"reported_{method}": felt, f"reported_held_{method}": felt, f"reported_ended_{method}": felt}
        row |= {f"reports_{method}": felt, f"reported_of_nothing_{method}": 0}
    return row | {"delay_s_ours": 0.1} | cells


def test_text_for_numbers_counts_as_no_number(tmp_path):
    spoiled = dict.fromkeys(approached(), "abc") | {"side": "normal", "object": "pipe"}
    run = write(tmp_path, "aura", [approached(), spoiled], behavior={"touch": True})
    found = table(section_of(aura, run), "by_side", *TOUCHED)["normal", "ours"]
    assert found == ["1", "100.0 % (20.7 to 100.0)", "0.100", "1", "1", "0"]
    assert build_report([run]).stat().st_size > 1000


TOUCHED = ("touches", "detected", "delay, s", "persistence", "end", "false")
REPORTED = ("approaches", "reported", "times", "persistence", "end", "where nothing can")

FELT = ("felt", "delay_s", "false", "held", "ended")
TRUTH = ("touches", *(f"{name}_{method}" for name in FELT for method in ("paper", "ours")))


def unknown(**cells):
    """The same where it is not known what touched: on a real bench, or over the wire."""
    return approached(**dict.fromkeys(TRUTH)) | cells


@pytest.mark.parametrize("bench", ["hardware", "emulated"])
def test_contact_on_a_bench_without_truth_is_counted_as_it_was_reported(tmp_path, bench):
    rows = [
        unknown(reports_ours=3, reported_of_nothing_paper=1),
        unknown(reported_ended_ours=0, outcome="contact"),
        unknown(reported_ours=0, reported_held_ours=0, reported_ended_ours=0, reports_ours=0),
        unknown(side="top"),
    ]
    section = touching(tmp_path, rows, bench=bench)
    assert section.title == "Contact (C4)"
    assert table(section, "by_side", *REPORTED) == {
        ("normal", "the paper's"): ["3", "0", "0", "0", "0", "1"],
        ("normal", "ours"): ["3", "2", "4", "2", "1", "0"],
        ("top", "the paper's"): ["1", "0", "0", "0", "0", "0"],
        ("top", "ours"): ["1", "1", "1", "1", "1", "0"],
    }
    unfelt = table(section, "by_side", "touches")["normal", "ours"]
    assert unfelt == [None], "no touch is known, so none was felt or missed"
    assert section.content["unknown"]
    assert not section.content["known"]


def test_without_truth_objects_have_no_rates_of_contact(tmp_path):
    rows = [unknown(object="mug"), unknown(object="notebook"), unknown(object="none", seen_ours=None)]
    section = touching(tmp_path, rows, bench="hardware", planned=3)
    assert section.title == "Objects (C5)"
    found = table(section, "by_object", "detected", "reported")
    assert found["nothing", "ours"] == found["mug", "ours"] == [None, "1"]


def test_the_report_on_contact_follows_the_profile_and_not_what_happened(tmp_path):
    missed = approached(touches=0, felt_ours=0, held_ours=0, ended_ours=0, delay_s_ours=None, false_ours=1)
    meant = write(tmp_path, "aura", [missed], behavior={"touch": True})
    passing = write(tmp_path, "aura", [missed], behavior={"touch": False})
    assert section_of(aura, meant).title == "Contact (C4)"
    found = table(section_of(aura, meant), "by_side", *TOUCHED)["normal", "ours"]
    assert found == [*"0––001"]
    assert section_of(aura, passing).title == "Pre-touch (C2)"
    assert table(section_of(aura, passing), "by_side", "touches", "reported")["normal", "ours"] == [None] * 2
    assert "Pre-touch (C2) and Contact (C4)" in text_of(build_report([passing, meant]))


def test_touches_are_counted_by_side_and_detector(tmp_path):
    rows = [
        approached(delay_s_ours=0.110),
        approached(delay_s_ours=0.090, ended_ours=0),
        approached(felt_ours=0, held_ours=0, ended_ours=0, delay_s_ours=None, false_ours=1, false_paper=1),
        approached(side="top", felt_ours=0, held_ours=0, ended_ours=0, delay_s_ours=None),
    ]
    section = touching(tmp_path, rows)
    counted = table(section, "by_side", *TOUCHED)
    # Wilson by hand: centre (p + z²/2n) / (1 + z²/n), half width z √(p(1-p)/n + z²/4n²) / (1 + z²/n), z² = 3.8415
    assert counted["normal", "ours"] == ["3", "66.7 % (20.8 to 93.9)", "0.100", "2", "1", "1"]
    assert counted["normal", "the paper's"] == ["3", "0.0 % (0.0 to 56.1)", "–", "0", "0", "1"]
    assert counted["top", "ours"][0] == "1"
    (felt,) = [result for result in section.summary if "2 of 3 touches detected" in result.text]
    assert not felt.met, "the paper's finger felt every touch of that side"
    assert felt.mark == "neither", "but what the simulated finger feels was assumed"


def test_contact_of_the_papers_method_that_does_not_come_out_is_told_and_no_goal_missed(tmp_path):
    rows = [approached(object="mug", felt_paper=felt, false_paper=1 - felt) for felt in (0, 1)]
    for felt, mark in ((rows, "worse"), (rows[1:], "neither")):
        section = touching(tmp_path, felt)
        marks = [r.mark for r in section.summary if "contact, the paper's" in r.text.lower()]
        assert marks == [mark, mark], "rate of touches, and of approaches without a false contact"


def test_the_page_opens_with_our_detector_beside_the_papers_on_the_same_touches(tmp_path):
    cells = ({"felt_paper": 1}, {}, {}, {"felt_ours": 0}, {"axis": "y", "felt_paper": 1})
    rows = [approached(**each) for each in (*cells, {"side": "top", "felt_ours": 0})]
    head = touching(tmp_path, rows).headline
    assert (head.of, head.ours, head.paper) == ("3 of 4", "75.0 %", "25.0 %"), "four touches along x"
    assert head.source.endswith("IV.A.3 prints all)"), "of the pipe, with the sides that hear"
    objects = touching(tmp_path, [approached(object="mug", felt_paper=1)] * 4)
    assert "93.7 %" in objects.headline.source
    passed = section_of(aura, write(tmp_path, "aura", rows, behavior={"touch": False})).headline
    assert (passed.of, passed.what) == ("5 of 5", "objects seen in time by our detector")
    half = [*[approached(object="mug")] * 4, *[approached(object="mug", felt_ours=None)] * 4]
    assert touching(tmp_path, half).headline.of == "4 of 4", "ours was armed in four"
    alone = [{name: cell for name, cell in row.items() if not name.endswith("_ours")} for row in rows]
    assert touching(tmp_path, alone).headline is None


def test_a_finger_need_not_feel_with_its_top(tmp_path):
    deaf = approached(side="top", felt_ours=0, held_ours=0, ended_ours=0, delay_s_ours=None)
    found = touching(tmp_path, [*[approached()] * 29, deaf]).summary
    (felt,) = [result for result in found if "29 of 29 touches" in result.text and "0 of 1" in result.text]
    assert (felt.kind, felt.met, felt.goal) == (Kind.ASSUMED, True, True)


def test_soft_objects_and_the_pipe_are_not_compared_with_the_papers_rates(tmp_path):
    """Ours sees and feels every one of the paper's objects, no soft one, and not the pipe."""
    blind = {"seen_ours": 0, "felt_ours": 0, "held_ours": 0, "ended_ours": 0, "delay_s_ours": None}
    rows = [
        *(approached(object=name) for name in ("mug", "notebook")),
        *(approached(object=name, **blind) for name in ("sponge", "cloth", "pipe")),
        *(approached(object="none", touches=0, alarms_ours=alarm, **blind) for alarm in (0, 0, 0, 1)),
    ]
    section = touching(tmp_path, rows)
    all_of_two = "100.0 % (34.2 to 100.0)"  # n / (n + z²)
    undecided = f"{all_of_two}: not decided with n = 2."
    for what, points, paper, of in (
        ("Pre-touch", "7.6", "92.4", "approaches"),
        ("Contact", "6.3", "93.7", "touches"),
        ("No false contact", "1.3", "98.7", "approaches"),
    ):
        text = f"{what}, ours: {points} points above the paper's {paper} % of its own objects: 2 of 2 {of}, "
        assert Result(Kind.ASSUMED, text + undecided, None, goal=True) in section.summary
    heads = ("approaches", "seen", "detected", "false", "alarms")
    found = table(section, "by_object", *heads)
    rest = "all but the soft ones and the pipe"
    names = [name for name, whose in found if whose == "ours"]
    assert names[-4:] == ["cloth (soft)", "sponge (soft)", rest, "nothing"]
    assert found[rest, "ours"] == ["2", all_of_two, all_of_two, "0", "0"]
    assert found["sponge (soft)", "ours"][1].startswith("0.0 %")
    assert found["nothing", "ours"] == ["4", None, "–", "0", "1"]
    alarms = [result.text for result in section.summary if "approaches to nothing" in result.text]
    assert any("ours: 1 alarms in 4 approaches to nothing, 25.0 % (4.6 to 69.9);" in text for text in alarms)
    assert found["sponge (soft)", "ours"][2] == "0.0 % (0.0 to 79.3)"
    assert table(section, "by_side", "approaches")["normal", "ours"] == ["3"], "the soft ones are not in it"


def test_contact_reported_of_nothing_counts_against_the_true_negatives(tmp_path):
    rows = [
        approached(object="mug"),
        approached(object="notebook", approaches=3, false_ours=2),
        approached(object="none", approaches=2, touches=0, felt_ours=0, false_ours=1),
    ]
    felt = table(touching(tmp_path, rows), "by_object", "approaches", "touches", "detected", "false")
    assert felt["notebook", "ours"][::3] == ["3", "2"]
    assert felt["nothing", "ours"] == ["2", "0", "–", "1"]


def test_distances_are_medians_by_side_and_speed_and_an_approach_along_another_axis_has_a_result(tmp_path):
    rows = [approached(distance_m_ours=d, undulations_per_cm=u) for d, u in ((0.01, 2.3), (0.05, 2.4))]
    rows += [approached(seen_ours=0, distance_m_ours=None), approached(speed_m_s=0.03, distance_m_ours=0.04)]
    sides = section_of(aura, write(tmp_path, "aura", rows)).content["by_side"]
    _, slow, _, fast = (list(map(str, row.values())) for row in sides)
    assert slow[:8] == ["normal", "x", "10", "2.35", "ours", "3", "66.7 % (20.8 to 93.9)", "30"]
    assert (fast[2], fast[5]) == ("30", "1")
    rows = [approached(axis="y", touches=0, seen_ours=seen, distance_m_ours=0.02) for seen in (1, 0)]
    found = section_of(aura, write(tmp_path, "aura", rows)).summary
    assert "seen in 1 of 2 approaches; 20 mm of the way left" in found[1].text


# --- C3 ----------------------------------------------------------------------------------------------


def centred(error_m, **cells):
    return {"object": "pipe", "method": "ours", "speed_m_s": 0.01, "error_m": error_m} | cells


def test_a_trial_that_does_not_vary_a_factor_has_the_behaviors_default(tmp_path):
    """In a list of trials some rows name the method, others do not: their cells are empty."""
    rows = [{"method": "paper", "speed_m_s": 0.03, "object": "paper_cylinder"}, {"method": None}]
    default = SearchFactors()
    section = section_of(centering, write(tmp_path, "centering", rows))
    assert {(row["object"], row["method"], row["speed, mm/s"]) for row in section.content["searches"]} == {
        ("paper cylinder", "paper", "30"),
        (default.object, default.method, f"{1000 * default.speed_m_s:g}"),
    }


def test_errors_searches_and_stops_are_counted(tmp_path):
    rows = [
        centred(0.001, search_s=3.0, touched=0, seen_to_stop_left_s=0.010, seen_to_stop_right_s=0.020)
        | {"gripped": 1, "contact_left_s": 0.4, "contact_right_s": 0.5},
        centred(-0.003, search_s=5.0, touched=1, seen_to_stop_left_s=0.030, seen_to_stop_right_s=0.040)
        | {"gripped": 1, "contact_left_s": 0.4},
        centred(None, touched=1),
    ]
    section = section_of(centering, write(tmp_path, "centering", rows))
    (line,) = ([*row.values()][1:] for row in section.content["searches"])
    assert line[:6] == ["pipe", "ours", "10", 3, "−1 ± 2.8 (2)", "4 ± 1.4 (2)"]
    assert line[6:] == ["0.6667 ± 0.58", "1 ± 0 (2)", "0.4 ± 0 (2)", "0.5 (1)", "3.00"]
    stops = [[*row.values()][1:] for row in section.content["stops"]]
    assert stops == [[2, "20", "30", "30"], [2, "30", "40", "40"]]
    text = "Pipe, ours, 10 mm/s: worst error 3.00 mm in 2 trials, 2.5 mm aimed at; 1 of 3 found no middle."
    assert section.summary == [Result(Kind.PREDICTED, text, False, goal=True)]


# --- runs that ended early ---------------------------------------------------------------------------


def marks(path):
    return re.findall(r'<li class="(met|missed|neither)">', path.read_text("utf-8"))


def test_a_run_that_measured_all_that_was_planned_is_judged_and_one_failed_trial_judges_nothing(tmp_path):
    page = build_report([write(tmp_path, "centering", [centred(0.001), centred(0.002)] * 15)])
    assert marks(page) == ["met"]
    sides = [approached(side=side) for side in ("normal", "back")]
    whole = write(tmp_path, "aura", sides, bench="hardware")
    failed = write(tmp_path, "aura", [approached(), {"outcome": "aborted", "side": "top"}], bench="hardware")
    assert "met" in marks(build_report([whole], tmp_path))
    page = build_report([whole, failed], tmp_path)
    assert "3 of 4 planned trials were measured" in text_of(page)
    assert set(marks(page)) == {"neither"}


@pytest.mark.parametrize("outcome", ["guard", "fault", "aborted"])
def test_a_run_that_ended_early_is_not_judged(tmp_path, outcome):
    rows = [centred(0.001), centred(0.002), centred(None, outcome=outcome)]
    page = build_report([write(tmp_path, "centering", rows, planned=340)])
    text = text_of(page)
    assert "2 of 340 planned trials were measured: no verdict in these lines." in text
    assert "worst error 2.00 mm in 2 trials, 2.5 mm aimed at" in text
    assert marks(page) == ["neither", "neither"]


def test_a_trial_that_was_run_again_counts_once(tmp_path):
    run = write(tmp_path, "centering", [centred(0.001), centred(0.002)], planned=2)
    again = [{**run.trials[0], "outcome": "guard"}, *run.trials]
    object.__setattr__(run, "trials", again)
    assert missing([run]) == ""
    object.__setattr__(run, "trials", [*again[:2], again[1]])
    assert missing([run]) == "1 of 2 planned trials were measured: no verdict in these lines."


def test_the_papers_method_beside_its_own_worst_is_no_good_news_and_ours_is_compared_with_it(tmp_path):
    rows = [centred(0.0035, method="paper"), *[centred(0.0002)] * 29]
    theirs, beside, ours = section_of(centering, write(tmp_path, "centering", rows)).summary[::-1]
    assert theirs.text.startswith("Pipe, the paper's, 10 mm/s: worst error 3.50 mm in 1 trial, the paper's 8")
    assert theirs.mark == "neither"
    assert "worst error 0.20 mm in 29 trials, 2.5 mm aimed at" in ours.text
    assert "17.5 times smaller than the paper's method's on this bench" in beside.text
    assert ours.mark == "met"
    few = section_of(centering, write(tmp_path, "centering", rows[:-1])).summary
    assert few[0].text.endswith("not decided with n = 28."), "nine in ten: 0.9 ** 28 is above 5 %"
    one = section_of(centering, write(tmp_path, "centering", [*rows[:2], centred(0.0026)])).summary
    assert one[0].mark == "missed", "one beyond a bound on the worst decides it"


def test_several_objects_are_judged_together_and_unknown_touches_and_grasps_are_not_called_none(tmp_path):
    rows = [centred(0.001, object=thing) for thing in ("pipe", "mug") for _ in range(15)]
    found = section_of(centering, write(tmp_path, "centering", rows))
    (result,) = found.summary
    assert result.text.startswith("2 objects, ours, 10 mm/s: worst error 1.00 mm in 30 trials, 2.5 mm aimed")
    assert result.mark == "met", "of 15 each object alone decides nothing"
    assert [row["object"] for row in found.content["searches"]] == ["mug", "pipe"]
    section = section_of(centering, write(tmp_path, "centering", [centred(0.001)], bench="hardware"))
    (line,) = section.content["searches"]
    assert not {"touched", "gripped"} & line.keys(), "nothing is known of them"
