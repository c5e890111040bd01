"""docs/reference/profiles.md is right: it shows what the program takes and prints."""

import re
from pathlib import Path

import pytest

from config.parts import parts_of
from config.profile import load_profile
from config.sections import ProfileTables
from config.source import ProfileError
from config.trials import read_csv

PAGE = (Path(__file__).resolve().parents[3] / "docs/reference/profiles.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


EXAMPLE, PARTS, JOINED, CROSSED = blocks("toml")


def load(text, path, **extra):
    path.write_text(text)
    return load_profile(path, **extra)


def test_the_examples_are_profiles_and_the_joined_one_is_what_the_shipped_one_begins_with(tmp_path):
    profile = load(EXAMPLE, tmp_path / "my.toml")
    assert len(profile.trials(0)) == 6
    assert profile.detectors["contact"].settings.threshold_sigma == 4.0
    assert load(JOINED, tmp_path / "my.toml").bench == "emulated"
    example = EXAMPLE[: EXAMPLE.index("[trials]")]
    assert len(load(example + CROSSED, tmp_path / "my.toml").trials(0)) == 27


def test_the_csv_example_gives_a_trial_a_row(tmp_path):
    (tmp_path / "trials.csv").write_text(blocks("csv")[0])
    profile = load(EXAMPLE, tmp_path / "my.toml", rows=read_csv(tmp_path / "trials.csv"))
    assert [trial.factors["location"] for trial in profile.trials(0)] == ["f"] * 3 + ["a"] * 3


def test_every_key_is_on_the_page():
    for key in (*ProfileTables.model_fields, "extends"):
        assert re.search(rf"`\[*{key}[.\]`]", PAGE), key


@pytest.mark.parametrize(
    ("right", "wrong", "line"),
    [
        ("threshold_sigma = 4.0", "threshold_sgima = 3.0", 0),
        ("[behavior]", "[limits]\nforce_n = -2.0\n\n[behavior]", 1),
        ("speed_m_s = 0.011997", "speed_mm_s = 4.8", 2),
    ],
)
def test_the_mistakes_read_as_shown(tmp_path, monkeypatch, right, wrong, line):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ProfileError) as caught:
        load(EXAMPLE.replace(right, wrong), Path("my.toml"))
    assert caught.value.problems[0] == blocks("text")[0].splitlines()[line]


def test_the_mistake_in_a_csv_file_reads_as_shown(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("trials.csv").write_text("speed_m_s\n0.004\n \n")
    with pytest.raises(ProfileError) as caught:
        read_csv("trials.csv")
    assert str(caught.value) == blocks("text")[0].splitlines()[3]


def test_the_page_example_of_parts_is_valid(tmp_path):
    (tmp_path / "mine.toml").write_text(PARTS)
    parts = parts_of(str(tmp_path / "mine.toml"))
    assert [arguments[0] for arguments in parts.runs] == ["mock/static", "mock/transient"]
