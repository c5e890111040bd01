"""Several runs from one profile: in one folder, with one report, and gone on with where they broke off."""

import shutil
import signal
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from config.parts import parts_of, run_context
from config.profile import load_profile
from config.script import run_trials
from config.source import ProfileError, profile_names
from controller.campaign import Campaign
from tests.refusals import refused

PAPERS = [name for name in profile_names() if name.startswith("papers/")]

TWO = """
title = "Two of them"
parts = [
    "mock/static --set behavior.settle_s=2.0 --only 1 --only 2",
    "mock/transient --set behavior.settle_s=2.0 --only 1 --only 2",
]

[[paper]]
item = "Fig. 4"
shows = "waveforms"
part = "mock/static"
differs = "one condition of three"

[[paper]]
item = "Fig. 1"
shows = "a drawing"
differs = "nothing is measured in it"
"""


@pytest.mark.parametrize("number", [np.float64, np.float32, np.int64, np.array])
def test_numbers_of_numpy_are_numbers_for_a_script(tmp_path, number):
    settings, out = {"behavior.settle_s": "1.0"}, str(tmp_path / "runs")
    rows = [{"condition": "none", "plant": {"noise_scale": number(1)}, "limits.force_n": number(2)}]
    outcome, run = run_trials("mock/static", rows, settings=settings, seed=np.int64(3), out=out, say=print)
    assert outcome.exit_code == 0, outcome.line
    assert (run.trials[0]["limits.force_n"], run.manifest["seed"]) == (2, 3)


@pytest.mark.parametrize("seed", [-1, 1 << 63])
def test_a_seed_that_is_none_is_refused_in_a_script(tmp_path, seed):
    with refused(ProfileError, "run_trials", "seed", str(seed)):
        run_trials("mock/static", [{"condition": "none"}], seed=seed, out=tmp_path)


def test_a_part_is_found_beside_the_profile_of_parts_from_wherever_it_is_named(tmp_path, monkeypatch):
    (tmp_path / "lab").mkdir()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lab" / "a b.toml").write_text('extends = "mock/transient"\n')
    paper = '[[paper]]\nitem = "1"\nshows = "it"\npart = "PART"\ndiffers = "no"\n'
    for part, there in (("a b.toml", "lab/a b.toml"), ("mock/static", "mock/static")):
        text = f"title = 'all'\nparts = [\"'{part}' --only 1\"]\n" + paper.replace("PART", part)
        (tmp_path / "lab" / "all.toml").write_text(text)
        parts = parts_of("lab/all.toml")
        assert [run[0] for run in parts.runs] == [shown.part for shown in parts.paper] == [there]


@pytest.fixture
def run(verb, tmp_path):
    def run(*arguments):
        code, out, err = verb(*arguments, "--out", tmp_path / "runs")
        assert not code, err
        return out

    return run


@pytest.fixture
def two(tmp_path):
    (tmp_path / "two.toml").write_text(TWO)
    return tmp_path / "two.toml"


@pytest.fixture
def begun(monkeypatch):
    """How many workers were begun each time; one thread in their place, for it is there at once."""
    counts = []

    def pool(count, *_, **__):
        counts.append(count)
        return ThreadPoolExecutor(1)

    monkeypatch.setattr("config.jobs.ProcessPoolExecutor", pool)
    return counts


def rows(campaign):
    return [path.read_bytes() for path in sorted(campaign.glob("*/trials.csv"))]


def test_parts_run_into_one_folder_with_one_report_and_go_on_where_they_broke_off(run, begun, two, tmp_path):
    printed = run("run", two, "--jobs", "2")
    assert begun == [2]  # the same workers for both
    assert "[2/2] mock/transient" in printed
    (campaign,) = (tmp_path / "runs").iterdir()
    whole = rows(campaign)
    assert len(whole) == 2
    page = (campaign / "report.html").read_text()
    assert "<h1>Two of them</h1>" in page
    assert '<td class="left">Fig. 4</td>' in page and 'href="#part1">Static contact (A1)</a>' in page
    assert "one condition of three" in page

    (static,), (transient,) = (list(campaign.glob(f"*{name}*")) for name in ("mock-static", "mock-transient"))
    shutil.rmtree(transient)
    header = (static / "trials.csv").read_bytes().splitlines(keepends=True)[0]
    (static / "trials.csv").write_bytes(header)
    (campaign / "report.html").unlink()
    run("resume", "latest")
    assert sorted(rows(campaign)) == sorted(whole)
    assert (campaign / "report.html").is_file()


@pytest.fixture
def killed(monkeypatch):
    """As each run closes its devices, after its last trial, somebody kills the program."""
    close = Campaign._close

    def closing(campaign):
        signal.raise_signal(signal.SIGTERM)
        close(campaign)

    monkeypatch.setattr(Campaign, "_close", closing)


def test_a_kill_that_comes_when_a_part_is_done_begins_no_other_one(killed, verb, two, tmp_path):
    assert verb("run", two, "--jobs", "1", "--no-report", "--out", tmp_path / "runs")[0] == 130
    (campaign,) = (tmp_path / "runs").iterdir()
    (static,) = campaign.glob("*/trials.csv")
    assert "mock-static" in str(static) and len(static.read_text().splitlines()) == 3


def test_a_kill_that_comes_as_a_device_fails_opens_nothing_anew(killed, verb, tmp_path):
    fails = ["--fault", "board off in BASELINE trial 1", "--set", "trials.reconnects=1"]
    code, _, err = verb("run", "mock/transient", "--only", "1", "--no-report", *fails, "--out", tmp_path)
    assert code == 3
    assert "reconnected" not in err


def test_a_script_of_many_runs_ends_with_the_one_that_is_killed(killed, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run_trials("mock/static", [{"condition": "none"}], out=tmp_path, say=lambda line: None)
    assert len(list(tmp_path.glob("*/trials.csv"))) == 1


def test_an_option_that_one_part_alone_could_take_is_refused(verb, tmp_path):
    code, _, err = verb("run", "papers/slip", "--only", "1", "--out", tmp_path)
    assert code == 2
    assert "run one of them" in err
    assert not list(tmp_path.iterdir())


def test_a_profile_that_is_a_part_of_itself_is_refused(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(f'title = "x"\nparts = ["{path}"]')
    with pytest.raises(ProfileError, match="has parts itself"):
        parts_of(str(path))


def test_a_part_that_cannot_be_planned_is_reported_by_the_exit_code(verb, tmp_path):
    (tmp_path / "two.toml").write_text('title = "x"\nparts = ["mock/static --only 99", "mock/static"]')
    code, _, err = verb("plan", tmp_path / "two.toml")
    assert code == 2
    assert "--only 99: no such trial" in err


@pytest.mark.parametrize("action", ["plan", "check"])
def test_what_a_part_is_run_with_is_planned_and_checked_with_it(verb, two, action):
    two.write_text(TWO.replace("--only 2", "--only 2 --seed 3"))
    assert not verb(action, two)[0]


@pytest.mark.parametrize("name", PAPERS)
def test_each_part_of_a_paper_is_a_profile_of_the_mock_bench_whose_settings_are_valid(name):
    for arguments in parts_of(name).runs:
        context = run_context(arguments)
        profile = load_profile(context.params["profile"], context.params["overrides"])
        assert profile.bench == "mock"
        assert set(context.params["numbers"]) <= {trial.id for trial in profile.trials(0)}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('title = "x"\nparts = []', "parts"),
        ('title = "x"\nparts = ["mock/static"]\nspeed = 1', "unknown key"),
        (TWO.replace('part = "mock/static"', 'part = "mock/slip"'), "none of the parts"),
        (TWO.replace('differs = "one condition of three"\n', ""), "differs"),
        ("title = 'x'\nparts = [\"mock/static 'open\"]", "'open\": no closing quotation"),
        ('title = "x"\nparts = [""]', "missing argument 'PROFILE'"),
        ('title = "x"\nparts = ["mock/static --onlly 1"]', "--onlly"),
        ('title = "x"\nparts = ["mock/static --out there"]', "--out"),
        ('title = "x"\nparts = ["nowhere"]', "no profile 'nowhere'"),
        ('title = "x"\nparts = ["papers/table_1"]', "has parts itself"),
    ],
)
def test_a_mistake_in_a_profile_of_parts_is_reported_with_its_place(text, message, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with refused(ProfileError, "mine.toml", message):
        parts_of(str(path))
