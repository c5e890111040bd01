import itertools
import resource
from pathlib import Path

import numpy as np
import pytest

from controller.recording.run_folder import RecordingError
from controller.recording.trial_rows import TrialRows, format_cell, read_rows
from tests.refusals import check_refusal

ROWS = [
    {"trial": 3, "outcome": "contact", "location": "f", "speed_m_s": 0.003785, "delay_s": 0.2},
    {"trial": 1, "outcome": "no_contact", "location": "a", "speed_m_s": 0.012, "delay_s": None},
    {"trial": 2, "outcome": "guard", "location": "b, back", "speed_m_s": 1 / 3, "delay_s": float("nan")},
]


def table(path, *rows):
    """A table that has written these rows."""
    written = TrialRows(path, ["location", "speed_m_s"], ["delay_s"])
    for row in rows:
        written.add(written.line(row))
    written.commit()
    return written


def test_the_file_is_this_to_the_byte(tmp_path):
    table(tmp_path / "trials.csv", *ROWS)
    assert (tmp_path / "trials.csv").read_bytes() == (
        b"trial,outcome,location,speed_m_s,delay_s\n"
        b"3,contact,f,0.003785,0.2\n"
        b"1,no_contact,a,0.012,\n"
        b'2,guard,"b, back",0.333333333,\n'
    )


def test_the_order_of_trials_changes_no_row(tmp_path):
    files = []
    for number, order in enumerate(itertools.permutations(ROWS)):
        table(tmp_path / f"{number}.csv", *order)
        files.append(sorted((tmp_path / f"{number}.csv").read_bytes().splitlines()))
    assert all(rows == files[0] for rows in files)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.1 + 0.2, "0.3"),
        (-0.0, "0"),
        (np.float64(1e-12), "1e-12"),
        (np.int64(7), "7"),
        (True, "true"),
        (12, "12"),
        ("f", "f"),
        (None, ""),
        (float("nan"), ""),
        (123456789.123, "123456789"),
    ],
)
def test_a_cell_is_written_by_one_rule(value, text):
    assert format_cell(value) == text


def test_what_is_read_is_what_was_written_but_a_last_line_that_is_cut(tmp_path):
    path = tmp_path / "trials.csv"
    assert read_rows(path) == ([], False), "no file is no trial"
    table(path, ROWS[0])
    table(path, ROWS[1])
    assert read_rows(path) == (ROWS[:2], False)
    path.write_bytes(path.read_bytes()[:-3])
    assert read_rows(path) == (ROWS[:1], True)
    table(path, ROWS[2])  # resumed: it goes on without the cut line
    rows, cut = read_rows(path)
    assert [row["trial"] for row in rows] == [3, 2]
    assert not cut


@pytest.mark.parametrize("text", ["nan", "inf", "1_000", "0x10", "a", "007", "1e5", "1E+05", "5."])
def test_text_that_is_no_number_as_they_are_written_stays_text(tmp_path, text):
    path = tmp_path / "trials.csv"
    table(path, {"trial": 1, "location": text})
    assert read_rows(path)[0][0]["location"] == text


def test_columns_that_do_not_fit_are_refused_by_name(tmp_path):
    path = tmp_path / "trials.csv"
    table(path)
    with pytest.raises(ValueError, match="columns are not those"):
        TrialRows(path, ["location"], ["delay_s"])
    with pytest.raises(ValueError, match="no column delai_s"):
        table(path, {"trial": 1, "delai_s": 0.1})
    path.write_text("trial,outcome\n1,contact\n2,contact,0.3\n")
    with pytest.raises(ValueError, match="line 3 has 3 cells, the header has 2"):
        read_rows(path)


def test_a_row_that_is_written_in_part_is_an_error(tmp_path):
    path = tmp_path / "trials.csv"
    table(path, ROWS[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 5, hard))
    try:
        with pytest.raises(OSError, match="File too large"):
            table(path, ROWS[1])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert read_rows(path) == (ROWS[:1], True)


def test_a_full_disk_is_one_line_with_the_remedy(tmp_path):
    path = tmp_path / "trials.csv"
    path.symlink_to("/dev/full")
    with pytest.raises(RecordingError, match="No space left on device while making") as caught:
        table(path)
    check_refusal(str(caught.value), "make room")
    assert isinstance(caught.value, OSError)
    assert caught.value.path == Path(path)
