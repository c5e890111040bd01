"""The study of Table I: its scoring, on made-up detections and digits."""

import numpy as np
import pytest

from benchmarks.table_1 import CHOSEN_ROWS, Detection, agreement, misfit_s, on_grid
from controller.reports.approaches import TABLE_1


def printed_again(factor=1.0, sigma_s=0.1):
    """Ten approaches a row with the paper's means, time and extent `factor` times as long."""
    apart = sigma_s * np.linspace(-1.0, 1.0, 10)
    return [
        [
            Detection(
                False,
                True,
                factor * row["delay_s"] + d,
                factor * row["extent_m"] + 1e-3 * d,
                row["force_n"] + d,
            )
            for d in apart
        ]
        for row in TABLE_1
    ]


def test_the_papers_own_means_are_within_scatter_in_every_row():
    found = agreement(printed_again())
    assert [found[name]["rows"] for name in ("time", "extent", "force")] == [14, 14, 14]
    assert found["time"]["ratio"] == pytest.approx(1.0)
    assert found["false"]["count"] == 0
    assert found["false_waited"]["count"] == 140


def test_times_twice_as_long_are_out_of_scatter_and_cost_as_much_as_they_are_off():
    twice = printed_again(2.0)
    assert agreement(twice)["time"]["rows"] == 0
    assert misfit_s(twice) == pytest.approx(
        np.sqrt(np.mean([TABLE_1[i]["delay_s"] ** 2 for i in CHOSEN_ROWS]))
    )


@pytest.mark.parametrize(
    ("mean", "sigma", "step", "fits"),
    [
        (0.23, 0.06, 0.1, True),  # 0.2, 0.2, 0.3
        (0.20, 0.00, 0.1, True),
        (0.20, 0.00, 1 / 15, True),  # three times 3/15
        (0.23, 0.06, 1 / 15, False),
        (0.59, 0.09, 0.1, False),
    ],
)
def test_a_printed_time_is_on_a_grid_where_three_multiples_have_its_mean_and_deviation(
    mean, sigma, step, fits
):
    assert on_grid(mean, sigma, step) is fits
