import math

import pytest

from controller.reports import flexion
from controller.reports.approaches import (
    TABLE_1,
    compare_columns,
    correlate,
    read_approaches,
    score_detectors,
    table_rows,
    trends,
)
from controller.reports.counts import (
    Trials,
    all_of,
    every,
    larger,
    mean_of,
    near,
    paired,
)
from controller.reports.section import ROWS
from controller.reports.transient import _study
from tests.unit.controller.reports.synthetic_runs import Given, write_transient


@pytest.fixture
def approaches_of(tmp_path):
    return lambda *given, **how: read_approaches([write_transient(tmp_path, given, **how)])


def test_mean_and_sigma_are_those_of_a_sample_where_there_are_so_many():
    mean = mean_of([1.0, None, 2.0, 6.0])
    assert (mean.mean, mean.n) == (3.0, 3)
    assert mean.sigma == pytest.approx(math.sqrt((4.0 + 1.0 + 9.0) / 2.0))
    assert math.isnan(mean_of([1.0]).sigma)
    assert math.isnan(mean_of([None]).mean)


def test_trials_fall_into_the_papers_rows_in_their_order_and_another_speed_into_one_at_the_end(approaches_of):
    ran = (("f", 0.011997), ("a", 0.003785), ("f", 0.004843), ("a", 0.003785), ("f", 0.004513))
    rows = table_rows(approaches_of(*(Given(*each) for each in ran)))
    found = [(row.location, round(row.speed_m_s * 1e6), len(row.approaches)) for row in rows]
    assert found == [("a", 3785, 2), ("f", 4843, 1), ("f", 4513, 1), ("f", 11997, 1)]
    assert [(row.paper or {})["force_n"] for row in rows] == [0.111, 0.050, 0.036, 0.099]
    rows = table_rows(approaches_of(Given("f", 0.007), Given("d", 0.004487), Given("f", 0.007)))
    found = [(row.location, row.paper is None, len(row.approaches)) for row in rows]
    assert found == [("d", False, 1), ("f", True, 2)]


def test_a_false_contact_is_counted_and_averaged_into_nothing_nor_is_a_bound_called_met_without_contact(
    approaches_of,
):
    (row,) = table_rows(approaches_of(Given(delay_s=0.2), Given(outcome="false_contact"), Given(delay_s=0.4)))
    assert row.approaches.total("false_contacts") == 1
    assert (row.mean("delay_s").mean, row.mean("delay_s").n) == (pytest.approx(0.3), 2)
    approaches = approaches_of(Given(outcome="no_contact", delay_s=None))
    assert [each.beside.met for each in compare_columns(approaches, table_rows(approaches))] == [None] * 3


def test_bounds_name_the_worst_approach_and_are_met_at_the_bound_itself(approaches_of):
    late = Given("h", 0.01, force_n=0.02, delay_s=0.382)
    approaches = approaches_of(Given(force_n=0.15, delay_s=0.1), late, Given(outcome="guard"))
    _, extent, force = columns = compare_columns(approaches, table_rows(approaches))
    assert [each.beside.ours for each in columns] == pytest.approx([0.1, 0.00382, 0.15])
    assert [each.beside.met for each in columns] == [None, False, None], "one row is no evidence of agreement"
    assert [(each.worst or {})["trial"] for each in (extent, force)] == [2, 1]


def test_a_bound_is_met_where_rows_agree_and_open_where_every_row_lies_far_below(approaches_of):
    def delays(scale):
        rows = [Given(row["location"], row["speed_m_s"], scale * row["delay_s"]) for row in TABLE_1] * 3
        return compare_columns(approaches := approaches_of(*rows), table_rows(approaches))[0]

    same, below = delays(1.0), delays(0.4)
    assert (same.beside.met, same.rows.met) == (True, True)
    assert delays(1.1).kept is None, "0.34 s on average, of a printed 0.3 s that stands for 0.35 as well"
    assert (below.beside.met, below.rows.met) == (None, False)
    assert below.rows.n == 14
    assert delays(1.5).beside.met is False, "0.45 s on average"


def test_a_row_is_within_scatter_where_three_of_ours_could_have_the_papers_mean(approaches_of):
    """Student's t with 3 of ours, 0.1 s of scatter: 4.303 x 0.1 s x sqrt(2 / 3) = 0.351 s either way."""

    def times(apart_s):
        rows = [
            Given(row["location"], row["speed_m_s"], row["delay_s"] + apart_s + off)
            for row in TABLE_1
            for off in (-0.1, 0.0, 0.1)
        ]
        return compare_columns(approaches := approaches_of(*rows), table_rows(approaches))[0]

    near, far = times(0.34), times(0.36)
    assert (near.within, near.judged, far.within) == (14, 14, 0)
    assert far.same is False


def test_forces_that_the_simulated_finger_was_fitted_to_are_not_held_against_the_papers(approaches_of):
    rows = [Given(row["location"], row["speed_m_s"], row["delay_s"], row["force_n"]) for row in TABLE_1]
    for bench, counted in (("mock", 11), ("hardware", 14)):
        approaches = approaches_of(*rows, bench=bench)
        delay, _, force = compare_columns(approaches, table_rows(approaches))
        assert (delay.rows.n, force.rows.n) == (14, counted)


def test_rank_correlation_sees_order_alone_of_three_points_with_some_spread():
    assert correlate([(1, 0.1), (2, 0.2), (3, 0.3), (4, 100.0)])[0] == pytest.approx(1.0)
    assert correlate([(1, 4), (2, 3), (3, 2), (4, 1)])[0] == pytest.approx(-1.0)
    assert correlate([(1, 1), (2, 3), (3, 2)])[0] == pytest.approx(0.5)
    assert math.isnan(correlate([(1, 1), (2, 2)])[0])
    assert math.isnan(correlate([(1, 1), (1, 2), (1, 3)])[0])


def test_the_papers_own_trends_are_those_of_its_rows():
    by_name = {name: paper for name, (_, _, paper) in trends([]).items()}
    # Location f by speed: forces 0.038 0.036 0.050 0.032 0.054 0.072 0.099 rank 3 2 4 1 5 6 7:
    # sum d^2 = 4 + 0 + 1 + 9 + 0 + 0 + 0 = 14, rho = 1 - 6 * 14 / (7 * 48) = 0.75.
    assert by_name["speed, at location f"] == (pytest.approx(0.75), 7)
    assert by_name["nearness to the joint, back"][0] == pytest.approx(1.0)
    # Pad d to h: 0.031 0.050 0.050 0.075 0.048 rank 1 3.5 3.5 5 2.
    assert by_name["nearness to the joint, pad"][0] == pytest.approx(0.359, abs=1e-3)


def test_our_trend_follows_our_forces_and_not_the_papers(approaches_of):
    speeds = sorted({row["speed_m_s"] for row in TABLE_1 if row["location"] == "f"})
    falling = [Given("f", speed, force_n=0.1 - 5 * speed) for speed in speeds]
    over_rows, over_trials, _ = trends(table_rows(approaches_of(*falling)))["speed, at location f"]
    assert (over_rows[0], over_trials[0]) == pytest.approx((-1.0, -1.0))


def test_trials_with_other_noise_stay_out_of_table_and_bounds_and_the_study_groups_them(approaches_of):
    approaches = approaches_of(Given(), Given(noise_scale=2.0, sample_hz=28.0, force_n=9.0))
    assert [len(row.approaches) for row in table_rows(approaches)] == [1]
    assert compare_columns(approaches, table_rows(approaches))[2].beside.ours == 0.05
    loud = {"noise_scale": 2.0, "sample_hz": 10.0}
    quiet = Given(noise_scale=0.5, sample_hz=28.0, delay_s=0.1)
    false = Given(**loud, outcome="false_contact")
    given = (Given(**loud, delay_s=0.5), quiet, false, Given(**loud, delay_s=0.7))
    rows = [[cell for name, cell in line.items() if name != ROWS] for line in _study(approaches_of(*given))]
    assert rows == [
        ["10", "2", 3, "0.6 ± 0.14 (2)", "1 of 3 (33 %)"],
        ["28", "0.5", 1, "0.1", "0 of 1 (0 %)"],
    ]


def test_a_detector_that_only_listened_is_scored_against_the_truth(approaches_of):
    scores = score_detectors(
        approaches_of(
            Given(observer_s=0.05, delay_s=0.2),
            Given(observer_s=-0.3),
            Given(observer_s=-0.005),  # before onset, after the touch: the truth is 10 ms before the onset
            Given(observer_s=-0.0115),  # a step and a half before the touch
            Given(observer_s=None),
        )
    )
    acting, observer = scores["contact"], scores["observer"]
    assert (acting.n, acting.true, acting.false, acting.silent) == (5, 5, 0, 0)
    assert (observer.true, observer.false, observer.silent) == (2, 2, 1)
    assert observer.delay_s.mean == pytest.approx((0.05 - 0.005) / 2)


def test_rows_come_out_the_same_in_whatever_order_trials_ran(tmp_path):
    given = [Given("a", 0.003785, 0.3), Given("f", 0.00254, 0.2), Given("f", 0.00254, 0.1)]
    orders = ((1, 2, 3), (3, 1, 2))
    ran = [read_approaches([write_transient(tmp_path, given, order=order)]) for order in orders]
    assert [[each["trial"] for each in approaches] for approaches in ran] == [[1, 2, 3]] * 2


@pytest.mark.parametrize(
    ("values", "aim", "met"),
    [  # Student's t of three values 0.1 apart: 4.303 x 0.1 / sqrt(3) = 0.248 either way
        ((0.9, 1.0, 1.1), 1.2, True),
        ((0.9, 1.0, 1.1), 1.3, None),
        ((0.9, 1.0, 1.1), 1.7, None),
        ((0.9, 1.0, 1.1), 1.8, False),
        ((1.0,), 1.0, None),
        ((1.0, 1.0), 1.0, True),
    ],
)
def test_a_mean_is_near_where_its_whole_interval_is(values, aim, met):
    assert near(mean_of(values), aim, within=0.5) is met


def test_one_mean_is_larger_where_both_intervals_say_so():
    low, high = mean_of((0.9, 1.0, 1.1)), mean_of((1.3, 1.4, 1.5))  # 0.4 apart; 0.248 x sqrt(2) = 0.351
    assert (larger(high, low), larger(low, high)) == (True, False)
    assert larger(low, mean_of((1.2, 1.3, 1.4))) is None
    assert larger(mean_of((5.0,)), low) is None, "one trial has no interval"


def test_two_shares_of_the_same_trials_are_told_apart_by_those_that_differ():
    """Two-sided: 2 x 0.5 ** 5 = 0.0625, 2 x 0.5 ** 6 = 0.031; of eight to one 2 x 10 / 512 = 0.039, of seven
    to one 2 x 9 / 256 = 0.070."""
    more, less, alike = [(1, 0)], [(0, 1)], [(1, 1), (0, 0)] * 50
    assert [paired(more * n + alike) for n in (0, 5, 6)] == [None, None, True]
    assert [paired(less * 6), paired(more * 8 + less), paired(more * 7 + less)] == [False, True, None]


def test_a_bound_on_every_trial_is_kept_from_29_on_and_all_of_several_unless_one_is_not():
    assert [every(0, 28), every(0, 29), every(1, 1000), every(0, 0)] == [None, True, False, None]
    assert [all_of(each) for each in ([True], [True, None], [None, False], [])] == [True, None, False, None]


def test_a_flexed_finger_opens_with_what_follows_the_tendon_beside_what_does_not():
    rows = Trials({"contact_blind": 1, "following_blind": blind} for blind in (0, 0, 0, 1))
    head = flexion._headline(rows)
    assert (head.ours, head.of, head.paper) == ("25.0 %", "1 of 4", "100.0 %")
    assert head.side == "", "three approaches of four differ: they decide nothing"
    many = flexion._headline(Trials([*rows, *rows]))
    assert (many.side, many.verdict.endswith("better than the paper's fixed one with 100.0 %")) == (
        "better",
        True,
    )
    assert flexion._headline(Trials([{"contact_blind": 1, "following_blind": None}])) is None
