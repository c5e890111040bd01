import pytest

from controller.reports.approaches import BOUNDS, TABLE_1

PRINTED = """
a 19.05 3.785 0.33 1.372 0.111 | 0.159 0.15 0.599 0.017
b 12.7 3.691 0.23 0.864 0.073 | 0.360 0.06 0.309 0.004
c 0 4.919 0.20 1.067 0.057 | 0.103 0.00 0.051 0.006
d 0 4.487 0.37 1.643 0.031 | 0.117 0.06 0.280 0.007
e 6.35 4.885 0.43 2.252 0.050 | 0.082 0.06 0.338 0.006
f 12.7 4.843 0.17 0.830 0.050 | 0.163 0.12 0.645 0.006
g 19.05 4.555 0.37 1.710 0.075 | 0.374 0.15 0.776 0.014
h 25.4 3.260 0.59 1.964 0.048 | 0.389 0.09 0.192 0.015
f 12.7 2.540 0.20 0.576 0.038 | 0.305 0.00 0.059 0.005
f 12.7 4.513 0.40 1.761 0.036 | 0.184 0.10 0.407 0.007
f 12.7 6.435 0.23 1.524 0.032 | 0.249 0.06 0.440 0.007
f 12.7 8.060 0.23 2.066 0.054 | 1.042 0.12 1.042 0.005
f 12.7 10.685 0.17 1.880 0.072 | 0.089 0.06 0.616 0.027
f 12.7 11.997 0.23 3.200 0.099 | 2.351 0.06 0.748 0.031
"""
"""Table I as the paper sets it, means and then sigmas, typed from the paper on its own."""


def test_table_1_is_what_the_paper_prints():
    columns = ("speed_m_s", "delay_s", "extent_m", "force_n")
    for row, line in zip(TABLE_1, PRINTED.strip().splitlines(), strict=True):
        location, position, *means = line.split("|")[0].split()
        assert (row["location"], row["micrometer_m"]) == (location, pytest.approx(float(position) / 1000))
        for column, mean, sigma in zip(columns, means, line.split("|")[1].split(), strict=True):
            scale = 1e-3 if "_m" in column else 1.0
            printed = (float(mean) * scale, float(sigma) * scale)
            assert (row[column], row[f"{column}.sd"]) == pytest.approx(printed)


def test_the_papers_own_rows_keep_the_papers_own_bounds():
    bound = {each["column"]: each["bound"] for each in BOUNDS}
    assert max(row["force_n"] for row in TABLE_1) <= bound["force_n"]
    assert max(row["extent_m"] for row in TABLE_1) <= bound["extent_m"]
    assert sum(row["delay_s"] for row in TABLE_1) / 14 == pytest.approx(bound["delay_s"], abs=0.02)


def test_extent_is_about_speed_times_time_in_every_row():
    for row in TABLE_1:
        assert row["extent_m"] == pytest.approx(row["speed_m_s"] * row["delay_s"], rel=0.35)
