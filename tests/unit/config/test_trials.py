"""The trials of a profile: list, grid and file; what a plan says that they cost."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.assemble import plan_campaign
from config.costs import _SIZES, _UNITS, _rounded, _speeds, cost, duration, planned
from config.jobs import jobs_for
from config.listing import profiles
from config.profile import load_profile
from config.source import ProfileError
from config.trials import (
    Trial,
    TrialsSettings,
    chosen,
    distinct,
    read_csv,
)
from tests.refusals import refused


def test_rows_meet_every_combination_the_last_factor_fastest_and_nested_factors_become_dotted():
    settings = TrialsSettings(list=[{"x": 1}, {"x": 2}], grid={"a": [1, 2], "b": [3, 4]})
    assert [tuple(trial.factors[name] for name in "xab") for trial in settings.trials()] == [
        *((1, 1, 3), (1, 1, 4), (1, 2, 3), (1, 2, 4)),
        *((2, 1, 3), (2, 1, 4), (2, 2, 3), (2, 2, 4)),
    ]
    assert TrialsSettings().trials() == [Trial(1, {}, 1)]
    (trial,) = TrialsSettings(list=[{"speed_m_s": 0.1, "plant": {"noise_scale": 2}}]).trials()
    assert trial.own == {"speed_m_s": 0.1}
    assert trial.overrides == {"plant.noise_scale": 2}


def shuffled(count, repeats=1, order="shuffled"):
    return TrialsSettings(list=[{"x": i} for i in range(count)], repeats=repeats, order=order)


@given(count=st.integers(1, 40), repeats=st.integers(1, 4), seed=st.integers(0, 2**32))
def test_shuffling_changes_the_order_and_no_trial(count, repeats, seed):
    settings = shuffled(count, repeats)
    listed = settings.trials()
    assert sorted(settings.trials(seed), key=lambda trial: trial.id) == listed
    assert [trial.id for trial in listed] == list(range(1, count * repeats + 1))
    assert settings.trials(seed) == settings.trials(seed)


def test_seeds_give_different_orders_and_listed_stays_and_single_trials_keep_their_numbers():
    listed = shuffled(10).trials()
    assert shuffled(10).trials(1) != shuffled(10).trials(2)
    assert shuffled(10, order="listed").trials(1) == listed
    assert chosen(listed, [4, 2]) == [listed[1], listed[3]]
    assert chosen(listed, [], (2, 5)) == [listed[1], listed[6]]
    with refused(ProfileError, "--only 11", "1 to 10"):
        chosen(listed, [11])


def test_a_csv_file_gives_numbers_text_and_truth_values(tmp_path):
    path = tmp_path / "trials.csv"
    path.write_text("location, speed_m_s,behavior.ready,n\nf, 4e-3,true,3\n\na,0.005,false,-2\n")
    assert read_csv(path) == {
        f"{path}: row 2": {"location": "f", "speed_m_s": 0.004, "behavior.ready": True, "n": 3},
        f"{path}: row 4": {"location": "a", "speed_m_s": 0.005, "behavior.ready": False, "n": -2},
    }


def test_a_csv_file_as_spreadsheets_save_it_is_read_and_one_that_is_missing_is_named(tmp_path):
    path = tmp_path / "trials.csv"
    path.write_bytes(b'\xef\xbb\xbf"location","speed_m_s"\r\n"f",0.004\r\n')
    assert [*read_csv(path).values()] == [{"location": "f", "speed_m_s": 0.004}]
    with refused(ProfileError, str(tmp_path / "none.csv"), "No such file"):
        read_csv(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", ["row 1", "location,speed_m_s"]),
        ("speed_m_s\n", ["no trials"]),
        ("speed_m_s,\n1,2\n", ["row 1", "''"]),
        ("a;b\n1;2\n", ["row 1", "'a;b'", "commas"]),
        ("x,x\n1,2\n", ["row 1", "'x'", "twice"]),
        ("x,y\n1,2\n3\n", ["row 3, column y", "one value for each factor"]),
        ("x,y\n1,2,3\n", ["row 2", "more cells than names"]),
        ("x,y\n1, \n", ["row 2, column y", "empty"]),
        ('x,y\n1,"2\n', ["no CSV"]),
        ("x\n\udcff\n", ["UTF-8", "position 2"]),
    ],
)
def test_a_bad_csv_file_is_one_line_with_row_and_column(tmp_path, text, named):
    path = tmp_path / "trials.csv"
    path.write_text(text, errors="surrogateescape")
    with refused(ProfileError, f"{path}: ", *named):
        read_csv(path)


def plan_of(name, **sets):
    profile = load_profile(name, {key.replace("__", "."): value for key, value in sets.items()})
    plan = plan_campaign(profile, profile.trials(0), 0)
    return profile, plan


def lines_of(name, **sets):
    profile, plan = plan_of(name, **sets)
    return list(planned(profile, plan.left, plan_campaign(profile, distinct(plan.left), 0), 1))


def test_what_was_never_measured_is_reported_as_such_and_wall_time_is_planned_in_wall_time():
    one, two = (cost("mock/transient", "transient", trials) for trials in (1, 2))
    assert two.bench_s == 2 * one.bench_s
    assert cost("mine.toml", "transient", 1) == one
    assert duration("mine.toml", "mine:Own", "mock", 3) == "not measured"
    assert duration("mine.toml", "transient", "mock", 3).endswith(", as shipped with its devices")
    assert "shipped" not in duration("hardware/transient", "transient", "hardware", 3)
    estimate = duration("hardware/transient", "transient", "hardware", 42)
    assert estimate.startswith("about 1.1 h")
    assert "computed" not in estimate
    assert any("of travel, at 0.01 m/s" in line for line in lines_of("mock/slip"))


def test_a_plan_shows_time_disk_motion_force_and_what_each_state_computes():
    plan = "\n".join(lines_of("mock/transient"))
    assert "42 trials of transient on the mock bench" in plan
    assert "opens     board, stage" in plan
    assert "of bench time, computed in" in plan
    assert "0.011997 m/s; the guard stops beyond 0.015 m/s" in plan
    most_n = 2.0 + 7300.0 * (0.011997 * 0.015 + 0.011997**2 / (2.0 * 0.5))
    assert f"the guard stops at 2 N; {most_n:.2g} N at the most if it alone does" in plan
    assert "15 ms (median and a turn), 0.5 m/s2 and 7300 N/m" in plan
    assert "SETTLING, RETRACTING\n          skipped: no subscriber" in plan
    assert "BASELINE, APPROACH\n          contact (board.period), ours (board.accelerometer)" in plan
    assert lines_of("emulated/pointer")[0].startswith("emulated/pointer: 1 trial of pointer")


def test_every_speed_is_planned_by_its_unit_and_without_one_no_peak_is_forecast():
    none = "\n".join(lines_of("mock/chirp", limits__stiffness_n_m="5000"))
    assert "of travel, no speed is set in m/s; the guard stops beyond" in none
    assert "no speed is set in m/s, so no peak is forecast" in none
    slides = {"slide_m_s": 0.015}, {"speed_m_s": 0.02}
    assert [list(_speeds(each)) for each in slides] == [[0.015], [0.02]]
    assert list(_speeds({"acceleration_m_s2": 1.0, "parts": [{"lift_m_s": -0.03, "grip_n": 4.0}]})) == [0.03]
    shaken = "\n".join(lines_of("mock/grasp", behavior__shake_m_s="0.5", limits__stiffness_n_m="5000"))
    assert "of travel, at 0.5 m/s" in shaken
    assert "with 0.5 m/s x " in shaken


@pytest.mark.parametrize(
    ("value", "units", "said"),
    [(820e3, _SIZES, "820 kB"), (1e6, _SIZES, "1 MB"), (7.4e6, _SIZES, "7.4 MB")]
    + [
        (n * 3600.0, _UNITS, said)
        for n, said in ((1.14, "1.1 h"), (47, "47 h"), (360, "15 days"), (0.4, "24 min"))
    ],
)
def test_what_a_plan_takes_is_in_plain_numbers(value, units, said):
    assert _rounded(value, units) == said


def test_all_cores_work_where_it_is_worth_their_start(monkeypatch):
    def count(name, asked=None):
        profile = load_profile(name)
        return jobs_for(profile, len(profile.trials(0)), asked)

    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1, 2, 3})
    assert count("mock/transient") == 1
    assert count("mock/centering") == 4
    assert count("mock/centering", 2) == 2
    assert count("emulated/transient") == 1


def test_list_counts_the_trials_that_are_run():
    listed = {}
    for each in profiles():
        if found := re.search(r"; (\d+) trials?:", each.line):
            listed[each.name] = int(found[1])
    assert listed["mock/grasp"] == 6
    for name, count in listed.items():
        assert count == len(load_profile(name).trials(0)), name
