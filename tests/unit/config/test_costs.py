"""What a campaign takes is estimated before it is run."""

import re

from config.assemble import plan_campaign
from config.costs import cost, duration, planned
from config.jobs import jobs_for
from config.listing import profiles
from config.profile import load_profile
from config.trials import distinct


def plan_of(name, **sets):
    profile = load_profile(name, {key.replace("__", "."): value for key, value in sets.items()})
    plan = plan_campaign(profile, profile.trials(0), 0)
    return profile, plan


def lines_of(name, **sets):
    profile, plan = plan_of(name, **sets)
    return list(planned(profile, plan.left, plan_campaign(profile, distinct(plan.left), 0), 1))


def test_what_was_never_measured_is_reported_as_such():
    assert (
        cost("mock/transient", "transient", 2).bench_s == 2 * cost("mock/transient", "transient", 1).bench_s
    )
    assert cost("mine.toml", "transient", 1) == cost("mock/transient", "transient", 1)
    assert duration("mine.toml", "mine:Own", "mock", 3) == "not measured"


def test_a_plan_shows_time_disk_motion_force_and_what_each_state_computes():
    plan = "\n".join(lines_of("mock/transient"))
    assert "42 trials of transient on the mock bench" in plan
    assert "opens     board, stage" in plan
    assert "of bench time, computed in" in plan
    assert "0.011997 m/s; the guard stops beyond 0.015 m/s" in plan
    assert "the guard stops at 2 N; 3.3 N at the most if it alone does" in plan
    assert "15 ms (median and a turn) x 7300 N/m" in plan
    assert "SETTLING, RETRACTING\n          skipped: no subscriber" in plan
    assert "BASELINE, APPROACH\n          contact (board.period), ours (board.accelerometer)" in plan
    assert lines_of("emulated/pointer")[0].startswith("emulated/pointer: 1 trial of pointer")


def test_a_bench_in_wall_time_is_planned_in_wall_time():
    estimate = duration("hardware/transient", "transient", "hardware", 42)
    assert estimate.startswith("about 1.1 h")
    assert "computed" not in estimate


def test_all_cores_work_where_it_is_worth_their_start(monkeypatch):
    def count(name, asked=None):
        profile, plan = plan_of(name)
        return jobs_for(profile, plan, asked)

    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1, 2, 3})
    assert count("mock/transient") == 1
    assert count("mock/centering") == 4
    assert count("mock/centering", 2) == 2
    assert count("emulated/transient") == 1


def test_a_speed_that_stands_deep_in_the_settings_is_planned():
    assert any("of travel, at 0.01 m/s" in line for line in lines_of("mock/slip"))


def test_list_counts_the_trials_that_are_run():
    listed = {}
    for each in profiles():
        if found := re.search(r"; (\d+) trials?:", each.line):
            listed[each.name] = int(found[1])
    assert listed["mock/grasp"] == 6
    for name, count in listed.items():
        assert count == len(load_profile(name).trials(0)), name
