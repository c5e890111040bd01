import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import stats

from controller.comparing import compared
from controller.measures.transient import COLUMNS
from controller.recording import reader
from controller.recording.reader import open_run
from controller.recording.run_folder import RecordingError, RunFolderError
from controller.registry import ExperimentKind
from controller.reports import first_screen, report, static
from controller.reports.approaches import TABLE_1
from controller.reports.counts import sized
from controller.reports.figures import Figures
from controller.reports.first_screen import headline_of
from controller.reports.hero import hero_of
from controller.reports.papers import headlines
from controller.reports.report import build_report, build_report_with_summary, comparison_page
from controller.reports.section import Comparing, Kind, Printed, Result
from controller.reports.settings import settings_table
from controller.reports.transient import section
from controller.reports.trial_signals import trial_table
from tests.unit.controller.reports.synthetic_runs import (
    ONSET_S,
    Given,
    begun,
    text_of,
    write_rows,
    write_static,
    write_transient,
)

CAMPAIGN = (
    Given("a", 0.003785, 0.33, 0.111),
    Given("d", 0.004487, 0.40, 0.031),
    Given("d", 0.004487, 0.36, 0.033),
    Given("f", 0.00254, 0.20, 0.038, observer_s=0.1),
    Given("f", 0.004843, 0.17, 0.2),
    Given("f", 0.004843, outcome="false_contact"),
    Given("f", 0.011997, None, None, "guard"),
)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    run = write_transient(tmp_path_factory.mktemp("campaign"), CAMPAIGN)
    return run, build_report([run])


def test_the_page_needs_nothing_but_itself_and_names_each_element_once(campaign):
    whole = campaign[1].read_text("utf-8")
    assert (whole.count("<script"), whole.count("</script>")) == (2, 2), "no script ends its own element"
    page = re.sub(r"<script\b.*?</script>", "", whole, flags=re.DOTALL)
    assert "default-src 'none'" in page, "nor would a browser let it ask"
    assert not re.findall(r"""(?:src|href)\s*=\s*["'](?![#?])""", page)
    assert "@import" not in page
    assert not re.findall(r"url\((?!#)", page)
    names = re.findall(r'\bid="([^"]+)"', page)
    assert len(names) == len(set(names)) > 50
    assert set(re.findall(r'href="#([^"]+)"', page)) <= set(names)
    assert set(re.findall(r"url\(#([^)]+)\)", page)) <= set(names)


def test_a_trial_is_read_once_for_all_that_ask_unless_it_is_too_large_to_be_kept(tmp_path, monkeypatch):
    run = write_static(tmp_path, {"none": 28.0})
    trial = run.recorded_trials[0]
    assert run.trial(trial) is run.trial(trial)
    monkeypatch.setattr(reader, "KEPT_BYTES", 0)
    again = open_run(run.folder.path)
    assert again.trial(trial) is not again.trial(trial)


def test_a_report_loads_no_library_that_it_can_do_without(tmp_path):
    folder = write_static(tmp_path, {"none": 28.0}).folder.path
    asked = (
        "import sys; from controller.recording.reader import open_run;"
        "from controller.reports.report import build_report;"
        f"build_report([open_run({str(folder)!r})]);"
        "print(sorted({'numba', 'pandas', 'pydantic', 'scipy'} & set(sys.modules)))"
    )
    root = Path(__file__).resolve().parents[4]
    done = subprocess.run([sys.executable, "-c", asked], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


SAID = {
    "Table I beside the paper's, with the difference": (
        "back a 19.05 3.785 1 0 0.33 (–) 0.33 (0.15) 0.00",
        "pad d 0.00 4.487 2 0 0.38 (0.03) 0.37 (0.06) +0.01",
        "pad f 12.70 4.843 1 1 0.17 (–) 0.17 (0.12) 0.00",
    ),
    "a bound that is missed, with its worst approach": (
        "largest 0.200 N, the paper's 0.150 N (IV.B): 33 % larger; the largest in trial 5, location f",
    ),
    "the stop certificates": (
        *("detection to command, ms 6 5 5 5", "command to standstill, ms 6 25 25 25"),
        "force peak, N 6 0.08",
    ),
    "the guard's stop": ("Trial 7, 93.500 s after it began, in APPROACH: force 2.1 N above 2 N.",),
}


def check_said(text, said, unsaid=()):
    """Every phrase of the one, none of the other."""
    assert [phrase for phrase in said if phrase not in text] == []
    assert [phrase for phrase in unsaid if phrase in text] == []


@pytest.mark.parametrize("what", SAID)
def test_the_page_has(campaign, what):
    check_said(text_of(campaign[1]), SAID[what])


def test_the_guards_stop_comes_before_anything_else_and_nothing_is_judged(campaign):
    text, page = text_of(campaign[1]), campaign[1].read_text("utf-8")
    stop = "The guard stopped every mover 2026-11-20T12-00-00Z_mock-transient_"
    assert 0 < text.index(stop) < text.index("6 approaches: 5 stopped at a contact")
    assert "missed" not in re.findall(r'class="(?:verdict )?(met|missed|neither)"', page)
    assert "<h1>A &lt;title&gt;</h1>" in page, "a title cannot break the page"
    assert f'title="delay_s: {COLUMNS["delay_s"]}"' in page


def test_figures_are_saved_beside_the_page_their_panels_with_letters(campaign):
    folder = campaign[0].folder.path / "figures"
    expected = ("fig_7_pad", "fig_8_back", "fig_9_speed")
    assert {path.name for path in folder.iterdir()} == {f"{name}.svg" for name in expected}
    figure = (folder / "fig_7_pad.svg").read_text("utf-8")
    assert [letter for letter in "abc" if f">{letter}</tspan>" in figure] == ["a", "b"]


CONTACT = {"kind": "resonance.paper", "average_samples": 10, "sample_hz": 15.0, "baseline_s": 1.0}
OTHER = {**CONTACT, "baseline_s": 10.0, "sample_hz": 28.0, "threshold_sigma": 5.0}

PAGES = {
    "a shortened settling": (
        lambda root: write_transient(root, CAMPAIGN[:1], settle_s=5.0),
        ("behavior.settle_s 5 90 (III.B)", "simulated"),
        (),
    ),
    "emulated": (lambda root: write_transient(root, CAMPAIGN[:1], bench="emulated"), ("simulated",), ()),
    "a contact without an onset": (
        lambda root: write_transient(root, [Given(delay_s=None)], bench="emulated"),
        ("stopped at a contact, 0 at a false contact. 1 of 1 contact has no delay, and may be false:",),
        (),
    ),
    "a real bench": (lambda root: write_transient(root, CAMPAIGN[:1], bench="hardware"), (), ("simulated",)),
    "the profile of the manifest": (
        lambda root: with_settings(
            write_transient(root, [Given()] * 10),
            detectors={"contact": OTHER},
            limits={"force_n": 1.5},
            title="",
        ),
        (
            "detectors.contact.baseline_s 10 1 (III.B)",
            "detectors.contact.threshold_sigma 5 3 (III.B)",
            "limits force_n 1.5 –",
        ),
        (),
    ),
    "what falls, and how erratic light contact is": (
        lambda root: write_static(root, {"none": 28.0, "light": 30.0, "full": 50.0}, repeats=2),
        (
            "Amplitude of motion 6.4 times smaller with full contact than without; it falls from none",
            "light 2 30 ± 0 2 ± 0 ",
        ),
        (),
    ),
    "a frequency that is the paper's": (
        lambda root: write_static(root, {"none": 27.98, "light": 30.2, "full": 49.0}),
        ("No contact: the same as the paper's 28 Hz, at 28.0 Hz", "Light contact: 0.2 Hz above the paper's"),
        (),
    ),
}


@pytest.mark.parametrize("what", PAGES)
def test_a_page_says(tmp_path, undrawn, what):
    write, said, unsaid = PAGES[what]
    text = text_of(build_report([write(tmp_path)]))
    check_said(text, said, unsaid)


def test_what_is_rounded_to_zero_has_no_sign_and_two_numbers_differ_in_words(tmp_path, undrawn):
    text = text_of(build_report([write_transient(tmp_path, [Given("d", 0.004487, 0.3, -4e-6)])]))
    assert " 0.000 (–) " in text
    assert not re.search(r"[-−]0(\.0+)?(?![.\d])", text)
    assert sized(0.016, 0.3, "s") == "19 times faster"
    assert sized(0.9, 0.3, "s") == "3 times slower"
    assert sized(1.1, 1.0, "N") == "10 % larger"
    assert sized(0.0, 0.3, "s") == ""


EARLY = [("fault", "A fault ended the run"), ("aborted", "The run was interrupted")]


@pytest.mark.parametrize(("status", "heading"), EARLY)
def test_a_run_that_ended_early_is_reported_at_the_top(tmp_path, undrawn, status, heading):
    run = write_transient(tmp_path, [Given()])
    ended = {"trials": 9, "exit": {"status": status, "reason": "stage: no reply"}}
    run.folder.write_manifest({**run.folder.read_manifest(), **ended})
    text = text_of(build_report([open_run(run.folder.path)]))
    said = (heading, ": stage: no reply", "1 of 9 planned trials were measured")
    places = [text.index(each) for each in said]
    assert places == sorted(places)


def test_a_terminal_of_80_columns_has_table_1_for_both_detectors_beside_the_papers(tmp_path, undrawn):
    given = [Given("f", 0.004843, 0.4, 0.05), Given("f", 0.004843, 0.2, 0.05, observer_s=0.1)]
    _, lines = build_report_with_summary([write_transient(tmp_path, given)])
    starts = [line[:5] for line in lines]
    head, row = starts.index("where"), starts.index("pad f")
    assert lines[head - 1].split("  ")[-1].strip() == "detector observer"
    assert " ".join(lines[row].split()) == "pad f 4.84 2 0 0.30 0.17 1.45 0.83 0.050 0.050 1 0 0.10"
    assert max(map(len, lines[head - 1 : row + 1])) <= 80


def test_a_figure_of_a_simulated_bench_is_marked_as_such(tmp_path):
    drawn = {}
    for simulated in (True, False):
        figures = Figures(tmp_path / str(simulated), simulated="simulated" if simulated else "")
        with figures.figure(2.0) as drawing:
            drawing.save("a")
            drawn[simulated] = [text.get_text() for text in drawing.figure.texts]
    assert drawn == {True: ["simulated"], False: []}


def test_no_error_bar_is_cut_even_where_the_spread_is_larger_than_the_mean(tmp_path, monkeypatch):
    inside = []

    def look(self, figure, name):
        for axes in figure.axes:
            low, high = axes.get_ylim()
            lines = [line for container in axes.containers for line in container[2]]
            bars = [bar[:, 1] for line in lines for bar in line.get_segments()]
            inside.extend(low <= bar.min() and bar.max() <= high for bar in bars)
        return "<svg></svg>"

    monkeypatch.setattr(Figures, "save", look)
    build_report([write_transient(tmp_path, [Given("d", 0.004487, 0.4, force) for force in (0.001, 0.2)])])
    assert inside
    assert all(inside)


def test_a_run_that_was_killed_is_reported_as_far_as_it_came(campaign, tmp_path, undrawn):
    killed = tmp_path / "killed"
    shutil.copytree(campaign[0].folder.path, killed)
    folder = open_run(killed).folder
    folder.write_manifest({**folder.read_manifest(), "exit": {"status": "running"}})
    for path, kept in ((folder.trials_path, 0.6), (folder.events_path, 0.7), (folder.recordings[0], 0.5)):
        path.write_bytes(path.read_bytes()[: int(kept * path.stat().st_size)])
    row = "back a 19.05 3.785 1 0 0.33"
    said = ("killed was cut off or damaged", "up to its last whole chunk", "its end was not recorded", row)
    check_said(text_of(build_report([open_run(killed)])), said)
    folder.recordings[0].unlink()
    text = text_of(build_report([open_run(killed)]))
    assert "There is no recording.mcap: nothing that was sampled can be shown." in text
    assert row in text


def flip(path, bit):
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)


def test_a_damaged_chunk_costs_its_figure_alone_and_the_page_says_so_in_one_line(campaign, tmp_path):
    damaged = tmp_path / "damaged"
    shutil.copytree(campaign[0].folder.path, damaged)
    run = open_run(damaged)
    drawn = hero_of("transient", [campaign[0]])[0].trial
    recorded = run._index.trials[drawn]
    path, (body, length) = recorded.path, recorded.chunks[-1]  # the approach that is drawn as the typical one
    flip(path, 8 * (body + length // 2))
    shutil.rmtree(damaged / "figures")
    text = text_of(build_report([run]))
    assert text.count(f"The recording of trial {drawn} is damaged") == 1
    assert "back a 19.05 3.785 1 0 0.33" in text
    assert "Typical:" not in text
    figures = sorted(each.stem for each in (damaged / "figures").iterdir())
    assert figures == ["fig_7_pad", "fig_8_back", "fig_9_speed"]


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_one_flipped_bit_leaves_a_page_or_the_readers_own_error(small_runs, undrawn, data):
    run = data.draw(st.sampled_from(small_runs))
    files = ["recording.mcap", "trials.csv", "events.jsonl", "manifest.json"]
    path = run.folder.path / data.draw(st.sampled_from(files))
    whole = path.read_bytes()
    if not whole:
        return
    flip(path, data.draw(st.integers(0, 8 * len(whole) - 1)))
    try:
        assert build_report([open_run(run.folder.path)]).stat().st_size > 1000
    except RunFolderError as error:
        assert path.name in str(error)
    finally:
        path.write_bytes(whole)


@pytest.fixture(scope="module")
def small_runs(tmp_path_factory):
    root = tmp_path_factory.mktemp("small")
    return [
        write_static(root, {"none": 28.2, "light": 33.0, "full": 49.0}),
        write_transient(root, [CAMPAIGN[0], CAMPAIGN[5], CAMPAIGN[6]]),
    ]


def test_a_column_without_its_name_or_with_text_for_numbers_leaves_a_page(small_runs, undrawn):
    for run in small_runs:
        path = run.folder.path / "trials.csv"
        whole = path.read_text()
        columns, *rows = [line.split(",") for line in whole.splitlines()]
        kept = [[*row[:3], *("abc" for _ in row[3:])] for row in rows]
        spoiled = [[columns, *kept]]
        for name in columns[2:]:
            spoiled.append([[f"q{name[1:]}" if each == name else each for each in columns], *rows])
        for lines in spoiled:
            path.write_text("".join(f"{','.join(line)}\n" for line in lines))
            assert build_report([open_run(run.folder.path)]).stat().st_size > 1000
        path.write_text(whole)


def test_an_event_without_its_detector_leaves_a_page(small_runs, undrawn):
    for run in small_runs:
        events = [{name: value for name, value in each.items() if name != "detector"} for each in run.events]
        assert build_report([replace(run, events=events)]).stat().st_size > 1000


def test_a_run_without_one_finished_trial_has_a_report(tmp_path, undrawn):
    for run in (write_transient(tmp_path, ()), write_static(tmp_path, {})):
        assert build_report([run]).stat().st_size > 1000


def test_several_runs_are_pooled_by_experiment(tmp_path):
    study = [Given(noise_scale=noise, sample_hz=rate) for noise in (0.5, 1.0) for rate in (10.0, 15.0)]
    runs = [write_transient(tmp_path, given) for given in (CAMPAIGN[:3], study)]
    runs.append(write_static(tmp_path, {"none": 28.2, "light": 33.0, "full": 49.0}))
    path = build_report(runs, out=tmp_path)
    text = text_of(path)
    assert path == tmp_path / "report.html"
    assert "7 approaches (contact: 7)" in text
    assert (
        "detectors.contact.sample, Hz plant.noise scale n delay, s false contacts 10 0.5 1 0.2 0 of" in text
    )
    assert "Light contact: 3.0 Hz above the paper's 30 Hz, at 33.0 Hz" in text
    assert [file.name for file in (tmp_path / "figures" / "static_mock").iterdir()] == ["fig_4_waveforms.svg"]


def with_settings(run, **settings):
    """The same run with other settings of its profile."""
    manifest = run.folder.read_manifest()
    manifest["profile"]["resolved"] |= settings
    run.folder.write_manifest(manifest)
    return open_run(run.folder.path)


def test_runs_of_different_settings_stand_apart_and_the_page_says_what_differs(tmp_path, undrawn):
    usual, same = (write_transient(tmp_path, [Given(delay_s=delay_s)]) for delay_s in (0.2, 0.4))
    other = with_settings(
        write_transient(tmp_path, [Given(delay_s=0.9)]),
        detectors={"contact": {**CONTACT, "kind": "resonance", "baseline_s": 10.0}},
        plant={"noise_scale": 2.0},
    )
    devices = [{"stage": {"driver": "zaber_stage", "port": f"/dev/ttyUSB{n}"}} for n in range(2)]
    usual = with_settings(usual, devices=devices[0])
    same = with_settings(same, title="Another title", trials={"repeats": 1}, devices=devices[1])
    text = text_of(build_report([usual, other, same], tmp_path))
    assert "2 approaches: 2 stopped at a contact" in text, "title, trials and ports change no trial"
    assert "1 approach: 1 stopped at a contact" in text
    assert "pad f 12.70 4.843 2 0 0.30 (0.14)" in text
    assert "pad f 12.70 4.843 1 0 0.90 (–)" in text
    differing = text[text.index("Settings that differ") : text.index("first contact (A2) mock, settings 1")]
    assert "detectors.contact.baseline_s 1 10 detectors.contact.kind resonance.paper resonance" in differing
    assert "plant.noise_scale – 2" in differing
    assert "settle_s" not in differing


RATES = [([28.0], "28"), ([None, None], "15"), ([None, 28.0], "15 (varied: 15, 28)")]


@pytest.mark.parametrize(("rates_hz", "here"), RATES)
def test_the_settings_are_those_that_the_trials_were_run_with(tmp_path, rates_hz, here):
    run = write_transient(tmp_path, [Given(sample_hz=rate_hz, noise_scale=1.0) for rate_hz in rates_hz])
    table = settings_table(run, {"detectors.contact.sample_hz": Printed("not printed", "V.B")})
    assert {"setting": "detectors.contact.sample_hz", "here": here, "the paper": "not printed (V.B)"} in table
    rest = {row["setting"]: row["here"] for row in settings_table(run, {})}
    assert f"sample_hz {here}," in rest["detectors.contact"]


def test_trials_in_which_a_setting_was_varied_are_in_no_row_of_the_others(tmp_path, undrawn):
    varied = Given(delay_s=0.9, noise_scale=2.0, sample_hz=28.0)
    text = text_of(build_report([write_transient(tmp_path, [Given(delay_s=0.2), varied])]))
    assert "pad f 12.70 4.843 1 0 0.20 (–)" in text
    run = write_static(tmp_path, {"none": 28.0, "light": 30.0, "full": 50.0})
    object.__setattr__(run, "trials", [{**row, "plant.wander": n % 2} for n, row in enumerate(run.trials)])
    text = text_of(build_report([run]))
    assert "mock, plant.wander 0 mock, plant.wander 1" in text
    assert "plant.wander 0 1" in text


def test_no_title_of_a_profile_states_a_number_that_another_profile_may_change():
    numbers = r"\b(one|two|three|four|five|six|ten|hour|\d[\d.]*)\b"
    for path in (Path(report.__file__).parents[2] / "config" / "profiles").rglob("*.toml"):
        assert not re.search(numbers, tomllib.loads(path.read_text("utf-8")).get("title", "")), path


def test_what_was_put_in_or_assumed_has_no_mark_on_a_simulated_bench_and_has_one_on_a_real_one(
    tmp_path, undrawn
):
    frequencies = {"none": 28.0, "light": 30.0, "full": 46.0}
    marks = {}
    for bench in ("mock", "hardware"):
        page = build_report([write_static(tmp_path, frequencies, bench=bench, repeats=2)]).read_text("utf-8")
        marks[bench] = re.findall(r'<li class="(\w+)"><span class="kind">(\w+)', page)
    put_in = [("neither", kind) for kind in ("fitted", "assumed", "fitted")]
    assert marks["mock"] == [*put_in, ("same", "predicted")]
    assert marks["hardware"] == [(mark, "measured") for mark in ("same", "same", "apart", "same")]


def test_a_new_experiment_has_its_columns_means_spreads_and_a_plot_without_any_code(tmp_path):
    given_ = [Given("a", 0.003785, 0.30), Given("a", 0.003785, 0.40), Given("f", 0.00254, 0.20)]
    run = write_transient(tmp_path, given_)
    run.folder.write_manifest({**run.manifest, "experiment": "twisting"})
    path = build_report([open_run(run.folder.path)], also=("pdf", "png"))
    text = text_of(path)
    of_two = "0.35 ± 0.071"
    said = ("location speed, mm/s n", "delay, s", of_two, "Succeeded: 100.0 % (43.9 to 100.0).")
    check_said(text, said, ["Contact: 100.0 %"])
    assert path.read_text("utf-8").count("<svg aria-label") == 1
    assert {file.suffix for file in (path.parent / "figures").iterdir()} == {".svg", ".pdf", ".png"}


def test_a_folder_that_cannot_be_written_is_one_clear_line_and_no_run_no_report(campaign, tmp_path, undrawn):
    (tmp_path / "report.html.tmp").symlink_to("/dev/full")
    with pytest.raises(RecordingError, match=r"No space left on device while writing .*report\.html"):
        build_report([campaign[0]], out=tmp_path)
    with pytest.raises(ValueError, match="at least one run"):
        build_report([])


def test_the_first_figure_has_the_success_of_median_delay_and_a_failed_trial(campaign):
    run = campaign[0]
    delays_s = sorted((row["delay_s"], row["trial"]) for row in run.trials if run.succeeded(row))
    typical, failed = hero_of("transient", [run])
    assert (typical.name, typical.trial) == ("typical", delays_s[(len(delays_s) - 1) // 2][1])
    assert failed.name == "failed"
    assert not run.succeeded(next(row for row in run.trials if row["trial"] == failed.trial))
    moments = typical.moments
    assert (moments.zero, moments.detector) == ("touch", "contact")
    row = next(row for row in run.trials if row["trial"] == typical.trial)
    assert moments.decided_s == row["detect_s"]


def test_of_two_runs_beside_each_other_each_has_its_own_typical_trial(campaign, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(campaign[0].folder.path, other)
    page, said = comparison_page(campaign[0], open_run(other), Comparing([], [], []))
    assert said.startswith("No difference told: time from touch to detection "), "it is the same run"
    first = page[page.index('<section id="summary">') : page.index('<section id="compared">')]
    drawn = re.findall(r'data-open="r(\d)t(\d+)">trial (\d+)</a></b> of (.*?),', first)
    typical = str(hero_of("transient", [campaign[0]])[0].trial)
    names = [campaign[0].folder.path.name, "other"]
    assert drawn == [(str(number), typical, typical, name) for number, name in enumerate(names)]


def test_of_two_runs_pairs_of_trials_decide_as_in_the_lines_of_compare(tmp_path, undrawn):
    """Each 10 ms later, 1 ms either way: less than single trials scatter, and told nevertheless."""
    delays_s = [0.2 + 0.01 * n for n in range(10)]
    one = write_transient(tmp_path, [Given(delay_s=delay_s) for delay_s in delays_s])
    later = [Given(delay_s=delay_s + 0.01 + 0.001 * (-1) ** n) for n, delay_s in enumerate(delays_s)]
    other = write_transient(tmp_path, later)
    one, other = (replace(run, manifest={**run.manifest, "commit": "", "seed": 1}) for run in (one, other))
    said = comparison_page(one, other, Comparing([], [], []))[1]
    assert said == (
        "The first is better: time from touch to detection 255 ms, 4.1 % slower than the first run's 245 ms, "
        "over 10 pairs of trials."
    )
    (line,) = [line for line in compared(one, other) if line.startswith("delay, s: +0.01 (")]
    assert line.endswith("n = 10")
    broken = replace(
        other, trials=[*other.trials[:9], {**other.trials[9], "outcome": "guard", "delay_s": 9.0}]
    )
    assert "over 9 pairs" in comparison_page(one, broken, Comparing([], [], []))[1]
    assert "9 pairs of trials, of 10 and 10" in compared(one, broken)


def test_an_experiment_opens_with_its_number_its_interval_and_the_papers(campaign):
    run = campaign[0]
    known = [row["delay_s"] for row in run.trials if row.get("delay_s") is not None]
    found = headline_of("transient", [run], [], None)
    assert float(found.ours.split()[0]) == pytest.approx(1000 * np.mean(known), rel=5e-3)
    assert (found.ours.split()[1], found.paper) == ("ms", "300 ms"), "one unit for both"
    low, high = map(float, re.findall(r"[\d.]+", found.interval))
    half = stats.t.ppf(0.975, len(known) - 1) * np.std(known, ddof=1) / np.sqrt(len(known))
    ends_ms = [1000 * (np.mean(known) - half), 1000 * (np.mean(known) + half)]
    assert [low, high] == pytest.approx(ends_ms, rel=1e-2)
    least, most = map(float, re.findall(r"[\d.]+", found.spread))
    assert [least, most] == pytest.approx([1000 * min(known), 1000 * max(known)], rel=1e-2)
    good = sum(map(run.succeeded, run.trials))
    assert f"{good} of {len(run.trials)} trials stopped at the contact" in found.verdict


def test_predictions_and_goals_are_counted_apart(campaign):
    results = [
        Result(Kind.PREDICTED, "", met, better=better)
        for met, better in ((True, None), (False, None), (False, True), (False, False))
    ]
    results += [Result(Kind.MEASURED, "Time: 2 s.", False, goal=True), Result(None, "")]
    found = headline_of("transient", [campaign[0]], results, None)
    assert found.verdict.endswith("; 1 of 1 goal missed: time (2 s).")
    assert found.state == "partly", "a goal that is missed is in the one verdict"
    goals = [("Force: 2 N.", False), ("", True)]
    more = results + [Result(Kind.MEASURED, text, met, goal=True) for text, met in goals]
    assert first_screen.goals_of(more) == "; 2 of 3 goals missed: time (2 s), force (2 N)"
    assert first_screen.agreement_of(more) == "1 as the paper, 1 better, 1 worse, 1 otherwise"


@pytest.mark.parametrize(
    ("outcomes", "mean_s", "said"),
    [
        ("contact " * 20, 0.1, "Went well in simulation: 20 of 20 trials stopped at the contact; "),
        ("contact " * 19 + "false_contact", 0.1, "Went well in simulation: 19 of 20 "),
        ("contact " * 18 + "false_contact " * 2, 0.1, "Went partly well in simulation: 18 of 20 "),
        ("contact " * 20, 0.6, "Went partly well in simulation: 20 of 20 "),
        ("contact " * 9 + "false_contact " * 11, 0.1, "Went badly in simulation: 9 of 20 trials "),
        ("false_contact " * 3, 0.1, "Went badly in simulation: 0 of 3 trials "),
    ],
)
def test_one_verdict_says_how_it_went_by_trials_goals_and_the_papers_number(tmp_path, outcomes, mean_s, said):
    words = enumerate(outcomes.split())
    given = [Given("d", 0.004487, mean_s + 0.001 * n, outcome=word) for n, word in words]
    found = headline_of("transient", [write_transient(tmp_path, given)], [], None)
    assert found.verdict.startswith(said)
    if "badly in simulation: 0" not in said:
        how = "better than the paper's 300 ms" if mean_s < 0.3 else "worse than the paper's 300 ms"
        assert how in found.verdict


@pytest.mark.parametrize(
    ("delays_s", "how"), [((0.29,), "beside"), ((0.31,), "beside"), ((0.1, 0.11), "better than")]
)
def test_one_trial_is_neither_better_nor_worse_than_the_paper(delays_s, how):
    rows = [{"delay_s": delay_s, "outcome": "contact"} for delay_s in delays_s]
    found = first_screen.listed(headlines("transient"), rows)
    assert f"{how} the paper's 300 ms" in found.verdict


@pytest.mark.parametrize(
    ("delays_s", "said", "side"),
    [  # Student's t of two values 0.07 apart: 12.71 x 0.035 s, from 0 to 0.53 s; of four 0.01 apart 8 ms either way
        ((0.05, 0.12), "85 ms, beside the paper's 300 ms (too few to tell apart)", ""),
        ((0.29, 0.30, 0.31, 0.30), "300 ms, about the paper's 300 ms", "as"),
        ((0.28, 0.29, 0.30, 0.31), "295 ms, about the paper's 300 ms", "as"),
    ],
)
def test_a_number_is_about_the_papers_where_its_whole_interval_is_near(delays_s, said, side):
    rows = [{"delay_s": delay_s, "outcome": "contact"} for delay_s in delays_s]
    found = first_screen.listed(headlines("transient"), rows)
    assert found.verdict.endswith(said)
    assert found.side == side


@pytest.mark.parametrize(
    ("errors_m", "side"), [((0.0079,), ""), ((0.0082,), "worse"), ((0.001,) * 29, "better")]
)
def test_the_largest_is_better_than_the_papers_once_so_many_trials_show_it(errors_m, side):
    rows = [{"error_m": error_m, "method": "ours", "outcome": "centred"} for error_m in errors_m]
    assert first_screen.listed(headlines("centering"), rows).side == side


def test_the_papers_number_stands_only_beside_what_it_is_of():
    rows = [{"object": "pipe", "axis": "y", "seen_paper": 1, "approaches": 1, "outcome": "approached"}] * 4
    listed, aura = first_screen.listed, headlines("aura")
    beside = [listed(aura, [{**row, "axis": axis} for row in rows]) for axis in "xy"]
    assert (beside[0].paper, beside[1]) == ("92.4 %", None)
    free = [{"condition": "none", "frequency_hz": 28.0, "outcome": "recorded"}]
    assert listed(headlines("static"), free).verdict == (
        "frequency without contact 28 Hz, about the paper's 28 Hz"
    ), "and not the frequency in full contact"
    touched = [{"delay_s": 0.1, "outcome": "contact"}] * 4
    kinds = ({"resonance.paper", "resonance"}, {"force.threshold"})
    delays = [listed(headlines("transient"), touched, each).paper for each in kinds]
    assert delays == ["300 ms", ""], "a load cell's delay is not that of a resonance"
    assert listed(headlines("transient"), touched).interval == "100 ms", "not from 100 to 100"


def test_static_conditions_are_met_within_their_tolerance_and_missed_beyond(tmp_path, undrawn):
    run = write_static(tmp_path, {"full": 46.9, "none": 28.9, "light": 28.0}, bench="hardware", repeats=2)
    found = static.section([run], Figures(tmp_path))
    shown = [(row["condition"], row["frequency, Hz"]) for row in found.content["at_rest"]]
    assert shown == [("none", "28.9 ± 0"), ("light", "28 ± 0"), ("full", "46.9 ± 0")]
    assert [result.met for result in found.summary][:3] == [True, True, False]
    once = write_static(tmp_path, {"full": 46.9, "none": 28.9, "light": 28.0}, bench="hardware")
    found = static.section([once], Figures(tmp_path))
    assert [result.met for result in found.summary] == [None] * 4
    assert all(result.text.endswith(": not decided with n = 1.") for result in found.summary)


def own(run, loss=None, **devices):
    """The run as one of an experiment of the user's own, with these devices."""
    profile = run.manifest["profile"]
    resolved = {**profile["resolved"], "title": "Poke a sponge", "devices": devices}
    named = {"experiment": "my_lab.poke:Poke", "profile": {**profile, "resolved": resolved}}
    run.folder.write_manifest({**run.manifest, **named, "loss": loss or {}})
    return open_run(run.folder.path)


@pytest.fixture
def unsectioned(monkeypatch, undrawn):
    """No module of one's own is looked for: the standard section reports it."""
    monkeypatch.setattr(report, "experiment_of", lambda *_: ExperimentKind(""))


def test_what_a_simulated_bench_measured_and_lost_is_said(tmp_path, unsectioned):
    """A device at a port of its own is real."""
    devices = {"stage": {"port": "emulated"}, "scale": {"port": "/dev/ttyUSB0"}}
    run = write_transient(tmp_path, [Given()], bench="emulated")
    page, lines = build_report_with_summary([own(run, {"scale.force": 12, "stage.position": 0}, **devices)])
    text = text_of(page)
    check_said(text, ("partly simulated", "What scale sent came through a port of its own and is measured."))
    assert lines[-2] == "Samples lost: 12 of scale.force."


def test_the_page_of_ones_own_experiment_has_its_title_and_nothing_of_a_paper(tmp_path, unsectioned):
    run = write_transient(tmp_path, [Given()])
    page, lines = build_report_with_summary([own(run)])
    text = text_of(page)
    assert lines[0] == "Poke a sponge, mock"
    assert "my_lab.poke:Poke" in text.partition("How it was run Dark")[2], "in the account alone"
    unsaid = ("my lab", "ours and not", "Fitted", "partly simulated")
    check_said(text, ["Where the numbers come from"], unsaid)
    assert ">the paper</th>" not in page.read_text("utf-8")


def test_a_page_of_two_runs_leaves_the_page_of_each_alone(tmp_path, undrawn):
    runs = [write_transient(tmp_path, [Given()]) for _ in range(2)]
    before = [build_report([run]).read_bytes() for run in runs]
    page = build_report(runs)
    assert page.parent.parent == tmp_path
    assert page.parent.name == f"report_{runs[0].folder.path.name}_{runs[1].folder.path.name}"
    assert [(run.folder.path / "report.html").read_bytes() for run in runs] == before


def test_beside_trials_of_some_rows_of_table_1_stands_the_papers_mean_of_these(tmp_path, undrawn):
    """Of a and d: (0.33 s + 3 x 0.37 s) / 4."""
    some = [Given("a", 0.003785, 0.32), *[Given("d", 0.004487, 0.35 + 0.01 * n) for n in range(3)]]
    run = write_transient(tmp_path, some)
    found = section([run], Figures(tmp_path))
    assert (found.headline.paper, found.headline.source) == ("360 ms", "the paper's (Table I, these rows)")
    (time,) = [result.text for result in found.summary if result.text.startswith("Time at detection")]
    assert "mean 0.35 s, the paper's 0.36 s (Table I, these rows)" in time
    other = section([write_transient(tmp_path, [*some, Given("f", 0.007)])], Figures(tmp_path))
    assert other.headline.paper == "", "no row of Table I is at 7 mm/s"
    papers = [Given(row["location"], row["speed_m_s"], row["delay_s"]) for row in TABLE_1]
    whole = section([write_transient(tmp_path, papers)], Figures(tmp_path))
    assert (whole.headline.paper, whole.headline.source) == ("300 ms", "the paper's (V.B)")


def test_trials_that_were_broken_off_stand_in_no_share_of_any_section(tmp_path, unsectioned):
    kept = [({"k": 1}, "kept", {"push_n": push_n}) for push_n in (1.0, 1.2)]
    broken = [({"k": 1}, outcome, {"push_n": 50.0}) for outcome in ("guard", "fault", "aborted")]
    run = write_rows(begun(tmp_path, "border", "mock", {}, successes=["kept"]), [*kept, *broken], ["push_n"])
    text = text_of(build_report([run]))
    check_said(text, ("Succeeded: 100.0 % (34.2 to 100.0).", "push, N: 1.1 ± 0.14 (2)."), ("60.0 %",))


def test_a_bound_has_its_verdict_and_its_worst_trial_in_one_line(tmp_path, undrawn):
    quick = [Given("d", 0.004487, 0.1 + 0.01 * n, 0.05) for n in range(2)]
    quick += [Given("e", 0.004885, 0.1, 0.05), Given("f", 0.004843, 0.1, 0.2)]
    quick += [Given("g", 0.004555, 0.12, 0.05)]
    found = section([write_transient(tmp_path, quick)], Figures(tmp_path / "figures"))
    time, _, force = [result for result in found.summary if "at detection:" in result.text]
    assert (time.met, time.goal, force.met, force.goal) == (None, True, False, True)
    assert "the largest, 0.12 s, in trial 5, location g at" in time.text
    assert "largest 0.200 N, the paper's 0.150 N (IV.B)" in force.text
    assert "in trial 4, location f at" in force.text


def test_times_that_chose_the_detectors_settings_are_fitted_and_have_no_mark(tmp_path, undrawn):
    papers = [Given(row["location"], row["speed_m_s"], row["delay_s"]) for row in TABLE_1]
    run = write_transient(tmp_path, papers)
    manifest = run.folder.read_manifest()
    manifest["profile"]["resolved"]["detectors"]["contact"]["sigma_of"] = "samples"
    run.folder.write_manifest(manifest)
    found = section([open_run(run.folder.path)], Figures(tmp_path / "figures"))
    kinds = {result.text.split(":")[0]: (result.kind, result.mark) for result in found.summary[:3]}
    assert kinds["Time"] == kinds["Extent"] == (Kind.FITTED, "neither")
    assert kinds["Force"][0] is Kind.PREDICTED


def test_an_onset_that_was_noise_is_said_to_lengthen_the_time(tmp_path, undrawn):
    """In this writer's truth the probe touches 10 ms before the load cell's onset."""
    run = write_transient(tmp_path, [Given("d", 0.004487, 0.3), Given("d", 0.004487, 0.3)])
    assert "noise reached" not in text_of(build_report([run]))
    late = [{**run.trials[0], "truth_contact_s": ONSET_S + 0.01}, *run.trials[1:]]
    text = text_of(build_report([replace(run, trials=late)]))
    assert "In 1 of 2 contacts the load cell's noise reached 0.005 N before the probe touched" in text


def test_a_trial_that_is_only_recorded_is_not_said_to_succeed_and_a_grasp_opens_with_its_grip(tmp_path):
    run = write_static(tmp_path, {"none": 28.0, "light": 30.0, "full": 50.0})
    assert headline_of("static", [run], [], None).verdict == (
        "Went well in simulation: frequency in full contact 50 Hz, about the paper's 50 Hz."
    ), "how many were recorded says nothing of how well"
    assert {row.state for row in trial_table([run])[1]} == {""}, "its outcome is no success of a detector"
    run = write_transient(tmp_path, [Given()] * 6)
    rows = [{**row, "outcome": "held", "grip_over_least": 1.1 + 0.1 * n} for n, row in enumerate(run.trials)]
    found = headline_of("grasp", [replace(run, trials=rows)], [], None)
    assert (found.ours, found.of) == ("1.35", "median of 6; less is better")
    assert found.interval == "1.1 to 1.6", "of six the least and the largest: 96.9 %"


def planned(run, trials):
    """The same run of so many planned trials."""
    run.folder.write_manifest({**run.folder.read_manifest(), "trials": trials})
    return open_run(run.folder.path)


def verdicts(*runs):
    """What the page opens with, and each of its parts."""
    parts = report._page(runs, None, "", (), ())[1]
    return [report._verdict(runs, parts)[0], *(part.headline.verdict for part in parts)]


def test_a_whole_run_in_which_a_setting_was_varied_is_not_called_broken_off(tmp_path, undrawn):
    run = planned(write_static(tmp_path, {"none": 28.0, "light": 30.0, "full": 50.0}, repeats=2), 6)
    varied = [{**row, "plant.wander": n % 2} for n, row in enumerate(run.trials)]
    whole, *parts = verdicts(replace(run, trials=varied))
    assert "in simulation: 6 of 6 trials recorded, in 2 parts" in whole
    assert [said.partition(":")[0] for said in (whole, *parts)] == ["Went well in simulation"] * 3
    cut, *parts = verdicts(replace(run, trials=varied[:4]))
    assert cut.startswith("Broken off in simulation: 4 of 6 trials recorded, in 2 parts")
    assert [said.partition(":")[0] for said in parts] == ["Broken off in simulation"] * 2


def test_where_trials_are_missing_no_sentence_says_better_than_the_papers(tmp_path, undrawn):
    quick = [Given("d", 0.004487, 0.1 + 0.001 * n) for n in range(10)]
    (said, _) = verdicts(planned(write_transient(tmp_path, quick), 20))
    assert said == (
        "Broken off in simulation: 10 of 20 trials stopped at the contact (not run: 10); "
        "time from touch to detection: 104 ms."
    )
    static = write_static(tmp_path, {"none": 28.0, "light": 30.0, "full": 50.0})
    both = verdicts(planned(write_transient(tmp_path, quick), 20), static)[0]
    assert both.startswith("Broken off in simulation: 13 of 23 trials ended as meant, in 2 parts")
    stopped = verdicts(write_transient(tmp_path, [*quick, Given(outcome="guard")]))[0]
    assert stopped.startswith("Broken off in simulation: 10 of 11 trials stopped at the contact (guard: 1)")


def test_what_is_not_judged_or_is_otherwise_did_not_go_well(tmp_path, undrawn):
    off = verdicts(write_static(tmp_path, {"none": 28.0, "light": 30.0, "full": 35.0}, repeats=3))[0]
    assert off.startswith("Recorded in simulation: frequency in full contact 35 Hz, beside the paper's 50 Hz")
    real = verdicts(write_static(tmp_path, {"full": 35.0, "none": 28.0}, bench="hardware", repeats=3))[0]
    assert real.startswith("Went partly well: frequency in full contact 35 Hz")
    unknown = write_transient(tmp_path, [Given(delay_s=None)] * 4, bench="hardware")
    assert verdicts(unknown)[0].startswith("Recorded: 4 of 4 trials ended at a detection.")
    touched = ({"location": "p"}, "contact", {"identified": "distal", "false_contacts": 0})
    wrong = write_rows(
        begun(tmp_path, "proximal", "mock", {}), [touched] * 5, ("identified", "false_contacts")
    )
    assert verdicts(wrong)[0].startswith("Went partly well in simulation: 5 of 5 trials ended as meant; ")


def test_contacts_that_nothing_judges_are_not_counted_as_none_false(tmp_path, undrawn):
    text = text_of(build_report([write_transient(tmp_path, [Given(delay_s=None)] * 4, bench="hardware")]))
    assert "pad f 12.70 4.843 4 – " in text
    known = text_of(build_report([write_transient(tmp_path, [Given(delay_s=None), Given()])]))
    assert "pad f 12.70 4.843 2 0 " in known
