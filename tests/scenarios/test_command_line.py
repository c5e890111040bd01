"""The command line as its users hold it: verbs, exit codes, one line for each mistake."""

import errno
import fcntl
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from config.assemble import plan_campaign, scene_check
from config.profile import load_profile
from config.rehearsal import refusals
from config.source import profile_names, read_source
from config.trials import distinct
from controller.holding import folder
from run import VERBS, cli
from tests.program import PATIENCE_S, ROOT, Terminal, started
from tests.refusals import check_refusal
from tests.unit.config.conftest import lab_values

QUICK = ["--set", "behavior.settle_s=2.0", "--set", "detectors.contact.threshold_sigma=8"]
"""The loop locks within a second; at eight sigma no trial ends by a false contact."""


def read_only(*_, **__):
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


# --- list, check -------------------------------------------------------------------------------------


def test_list_fits_a_screen_and_names_every_experiment_with_its_benches(verb):
    code, out, _ = verb("list")
    assert code == 0
    lines = out.splitlines()
    assert len(lines) <= 25
    assert re.search(r"^  transient +m e h  A2", out, re.MULTILINE)
    assert re.search(r"^A: contact .*Backus", out, re.MULTILINE), "what the letter stands for"
    named = set(re.findall(r"[\w/]+", out.replace("papers/", "")))
    for line in lines:
        name, _, also = line.strip().partition("; also ")
        named |= {name.split()[0] + each for each in also.split(", ")}
    assert {name.partition("/")[2] for name in profile_names() if "bench_" not in name} <= named


@pytest.mark.parametrize(
    "words",
    [["slip"], ["--hardware"], ["A2", "--mock"], ["barrett_hand", "--hardware"], ["b8", "--emulated"]],
)
def test_list_shows_those_that_fit_and_what_they_need(verb, words):
    code, out, _ = verb("list", *words)
    names = [line.split()[0] for line in out.splitlines()[:-1] if not line.startswith(" ")]
    assert code == 0
    assert len(out.splitlines()) <= 40
    benches = [word.removeprefix("--") for word in words if word.startswith("--")]
    assert names and all(name.startswith(tuple(benches) or "") for name in names)
    assert ("hardware/slip" in names) is (words in (["slip"], ["--hardware"], ["barrett_hand", "--hardware"]))
    assert ("port to set: all" in out) is ("hardware/slip" in names)


def test_list_refuses_what_fits_none(verb):
    check_refusal(verb("list", "zzz")[2], "'zzz'", "list")


def test_list_shows_drivers_and_detectors(verb):
    assert "zaber_stage" in verb("list", "--drivers")[1]
    assert "resonance.paper" in verb("list", "--detectors")[1]


@pytest.mark.parametrize(
    "line", ["3", '{"devices": {}}', '{"devices": 3, "control": {"host": "x", "port": 1}}']
)
def test_endpoints_that_no_emulator_printed_are_refused(verb, tmp_path, line):
    (tmp_path / "bench.json").write_text(line)
    code, _, err = verb("run", "emulated/transient", "--endpoints", tmp_path / "bench.json")
    assert code == 2
    check_refusal(err, "bench.json", "`run.py emulate`")


def loaded(commands, names):
    """Which of some modules a fresh program has loaded after commands that end well."""
    code = (
        f"import sys\nfrom run import cli\nfor command in {commands}:\n"
        "    try:\n        cli.main(command)\n    except SystemExit as ended:\n        assert not ended.code\n"
        f"print({names} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1]


def test_list_loads_nothing_heavy():
    heavy = {"numpy", "pydantic", "rich", "numba", "serial", "matplotlib", "scipy"}
    assert loaded([["list"]], heavy) == "set()"


def test_check_loads_no_compiler_and_nothing_that_records():
    sources = {name: read_source(name).data for name in profile_names() if name.startswith("mock/")}
    profiles = {data["experiment"]: name for name, data in sources.items() if "experiment" in data}
    heavy = {"numba", "scipy", "mcap", "pandas", "matplotlib", "rich"}
    assert loaded([["check", name] for name in profiles.values()], heavy) == "set()"


def test_check_prints_every_setting_with_the_file_that_gave_it(verb):
    code, out, _ = verb("check", "mock/transient", "--set", "limits.force_n=1.5")
    assert code == 0
    assert "# mock/transient: transient on the mock bench, 42 trials" in out
    lines = {line.split(" = ")[0]: line for line in out.splitlines() if " = " in line}
    assert lines["force_n"].endswith("# --set")
    assert lines["baseline_s"].endswith("config/profiles/mock/transient.toml")
    assert lines["rate_hz"].endswith("# default")
    assert out.splitlines()[-1] == "# nothing is missing"


def test_what_check_prints_is_a_profile_again(verb, tmp_path):
    (tmp_path / "printed.toml").write_text(verb("check", "mock/transient")[1])
    again = verb("check", tmp_path / "printed.toml")[1]
    assert again.splitlines()[1] == verb("check", "mock/transient")[1].splitlines()[1]


@pytest.mark.parametrize(
    ("name", "setting", "named"),
    [
        ("mock/slip", "behavior.sensors.dsa.stream=board.x", "[behavior.sensors.dsa] stream = board.x"),
        ("mock/transient", "limits.force_stream=board.lode_cell", "did you mean board.load_cell?"),
        ("mock/touch", "behavior.contact=nix", "no such detector to stop an approach that touches"),
        ("mock/grasp", "limits.grip_n=50.0", "tightest_n = 60.0: more than [limits] grip_n = 50.0"),
        ("mock/grasp", "behavior.tighten_speed_m_s=0.1", "more than [limits] speed_m_s = 0.06"),
    ],
)
def test_check_finds_a_stream_that_is_not_sent_and_a_trial_that_cannot_be_run(verb, name, setting, named):
    code, _, err = verb("check", name, "--set", setting)
    assert code == 2
    check_refusal(err, named)


@pytest.mark.parametrize(
    ("name", "bound", "states"),
    [
        ("mock/slip", "max_turn_rad_s=0.19", ["TILTING", "ROLLING", "LEVELLING"]),
        ("mock/slip", "max_speed_m_s=0.005", ["SLIPPING"]),
        ("mock/pointer", "max_turn_rad_s=0.2", ["TURNING"]),
        ("mock/border", "max_turn_rad_s=0.35", ["SLIPPING", "TURNING_BACK"]),
        ("mock/centering_turned", "max_turn_rad_s=1.0", ["HALF_TURN"]),
    ],
)
def test_check_names_each_motion_for_a_time_that_a_slower_arm_would_make_less_far(verb, name, bound, states):
    code, _, err = verb("check", name, "--set", "trials.repeats=1", "--set", f"devices.arm.{bound}")
    assert code == 2
    assert {line.split("refused: ")[1].split(":")[0] for line in err.splitlines()} == set(states)
    for line in err.splitlines():
        check_refusal(line, name, "less far", bound.partition("=")[0])


@pytest.fixture
def unrehearsed(monkeypatch):
    """Has runs begin without a rehearsal: what they are refused then comes from the bench."""
    return lambda: monkeypatch.setattr("config.campaigns.refusals", lambda *_: ())


@pytest.mark.parametrize(
    ("name", "sets", "named"),
    [
        ("mock/transient", ["limits.travel_m=0.009"], ["APPROACH", "0.01 m", "limits.", "travel_m"]),
        ("mock/transient", ["limits.speed_m_s=0.009"], ["RETRACTING", "0.01 m/s", "limits.speed_m_s"]),
        ("mock/transient", ["devices.stage.travel_max_m=0.005"], ["stage", "0.005 m", "travel_max_m"]),
        ("mock/centering", ["limits.reach_m=0.01"], ["CLEARING", "0.07 m", "limits.reach_m"]),
        ("mock/centering", ["devices.arm.leash_m=0.05"], ["arm", "0.05 m", "leash_m"]),
        ("mock/centering", ["limits.grip_n=6.0"], ["CLOSING", "10 N", "limits.grip_n"]),
        ("mock/objects", ["trials.list=[{object='nix'}]", "trials.grid={}"], ["taking nix", "pipe"]),
    ],
)
def test_check_names_what_a_run_would_be_refused_when_it_has_begun(
    verb, tmp_path, name, sets, named, unrehearsed
):
    chosen = [word for each in sets for word in ("--set", each)]
    code, out, err = verb("check", name, *chosen)
    assert code == 2
    assert "nothing is missing" not in out
    line = next(line for line in err.splitlines() if named[0] in line)
    check_refusal(line, name, "trial", *named)
    unrehearsed()
    code, _, err = verb("run", name, *chosen, "--only", 1, "--out", tmp_path, "--no-report")
    assert code == (4 if sets[0].startswith("limits.") else 3), "a check that refuses what runs is as wrong"
    assert named[-1] in err.splitlines()[-1]


def test_a_run_beyond_its_limits_is_refused_before_anything_is_opened(verb, tmp_path):
    sets = ("--set", "limits.travel_m=0.008")
    code, _, err = verb("run", "mock/transient", *sets, "--out", tmp_path / "runs")
    assert (code, err.count("\n"), "APPROACH" in err, list(tmp_path.iterdir())) == (2, 1, True, [])


def test_check_wires_an_emulated_bench_and_refuses_what_its_run_would(verb):
    profile = ("tests/data/serial_lines.toml", "--set", "devices.uno.port=emulated")
    stage = ("--set", "devices.stage.port=emulated")
    assert verb("check", *profile, *stage)[0] == 0
    code, _, err = verb("check", *profile, *stage, "--set", "devices.uno.streams.force.shows=[]")
    assert code == 3
    check_refusal(err, "shows nothing", "streams.force.shows", "load_cell")


def test_nothing_is_refused_of_a_shipped_profile():
    for name in profile_names():
        if name.partition("/")[0] in ("mock", "emulated") and "experiment" in read_source(name).data:
            profile = load_profile(name)
            plan = plan_campaign(profile, distinct(profile.trials(0)), 0)
            assert list(refusals(profile, plan.trials, scene_check(profile, plan.devices))) == []


def test_check_tells_which_streams_are_known_only_to_the_open_device(verb):
    code, out, err = verb("check", "emulated/transient", "--set", "limits.force_stream=board.lode_cell")
    assert (code, err) == (0, "")
    (line,) = [line for line in out.splitlines() if "--connect" in line]
    assert "board.lode_cell" in line
    assert "stage.position" not in line


def test_check_connect_reads_every_sensor_and_refuses_a_stream_that_the_open_device_has_not(verb):
    wrong = "limits.force_stream=board.lode_cell"
    code, out, err = verb("check", "mock/transient", "--connect", "--set", wrong)
    assert code == 2
    assert "    board.load_cell: " in out
    assert "    stage.position: " in out
    assert "[devices.stage]" not in out, "settings only where they are asked for"
    assert out.splitlines()[-1].split()[1::2] == ["ok,", "warn,", "fail"]
    check_refusal(err, "did you mean board.load_cell?")


def test_check_connect_names_a_signal_that_cannot_use_its_stream_and_detectors_that_were_not_tried(verb):
    code, out, err = verb("check", "mock/pretouch", "--connect", "--set", "signals.right.channel=5")
    assert code == 2
    check_refusal(err.strip(), "audio.fingers", "4 channels", "signals.right needs 12")
    assert re.search(r"detector \w+: not tried, as nothing came of signals\.right", out)


def test_check_connect_tries_detectors_of_computed_streams(verb):
    code, out, _ = verb("check", "mock/slip_calm", "--connect")
    assert code == 0
    assert re.search(r"detector \w+: takes signals\.\w+", out)


def test_check_connect_names_a_port_that_is_not_there_and_exits_with_3(verb):
    values = [f"--set={key}={value}" for key, value in lab_values("hardware/transient").items()]
    code, out, _ = verb("check", "hardware/transient", "--connect", *values)
    assert code == 3
    assert "stage: " in out
    assert "does not exist" in out


def test_check_connect_needs_ports_alone_and_names_what_a_run_would_miss(verb):
    ports = [f"--set={key}={port}" for key, port in lab_values("hardware/transient").items() if "port" in key]
    code, out, err = verb("check", "hardware/transient", "--connect", *ports)
    assert code == 2
    assert "does not exist" in out
    assert [line.partition("] ")[2].split()[0] for line in err.splitlines()] == [
        *("microstep_m", "travel_m", "force_n", "travel_m", "approach_limit_m", "threshold")
    ]


def test_check_connect_opens_nothing_of_a_bench_that_another_program_has(verb, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder().mkdir()
    theirs = {"carriage": {"port": "/dev/nowhere/stage"}}
    note = {"pid": os.getpid() + 1, "profile": "hardware/other", "doing": "run", "devices": theirs}
    with (folder() / "other.json").open("w") as held:
        json.dump(note, held)
        held.flush()
        fcntl.flock(held, fcntl.LOCK_EX)
        sets = [f"--set=devices.{name}.port=/dev/nowhere/{name}" for name in ("stage", "board")]
        code, out, err = verb("check", "hardware/transient", "--connect", *sets)
    assert code == 3
    check_refusal(err.strip(), "stage", "run of hardware/other", "stop hardware/other")
    assert "board" not in out, "no device was opened"


def test_all_values_that_a_lab_has_to_give_are_told_at_once_and_shown_as_not_set(verb):
    code, _, err = verb("run", "hardware/slip")
    assert code == 2
    assert len(err.splitlines()) == 14
    code, out, err = verb("check", "hardware/chirp")
    assert code == 2
    assert 'port = "? sounddevice:' in out
    check_refusal(err, "hardware/bench_aura.toml", "[devices.audio] port", "is not set", "sounddevice")


# --- mistakes: one line, exit code 2 -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["lst"], "'list'"),
        (["run"], "'PROFILE'"),
        (["run", "mock/transiet"], "did you mean 'mock/transient'"),
        (["run", "mock/transient", "--sed", "1"], "--sed"),
        (["run", "mock/transient", "--seed", "-1"], "--seed"),
        (["run", "mock/transient", "--seed", str(2**63)], "--seed"),
        (["run", "mock/transient", "--set", "limits.force_n"], "--set limits.force_n=1.5"),
        (["run", "mock/transient", "--set", "title=\udcff"], "no UTF-8 text"),
        (["run", "emulated/transient", "--endpoints", "nowhere.json"], "nowhere.json: No such file"),
        (["emulate", "mock/transient"], "try emulated/transient"),
        (["replay", "x.csv", "--detector", "resonance", "--baseline", "2"], "as in 2:12"),
        (["replay", "x.csv", "--detector", "resonance", "--baseline", "3:2"], "ends before it begins"),
        (
            ["replay", "x.csv", "--detector", "resonance.paper", "--set", "threshold_sgima=2"],
            "'threshold_sigma'",
        ),
    ],
)
def test_a_mistake_on_the_command_line_is_one_line_and_exit_code_2(verb, arguments, named):
    code, out, err = verb(*arguments)
    assert (code, out) == (2, "")
    check_refusal(err, named)


def test_the_program_alone_shows_its_verbs(verb):
    code, out, _ = verb()
    assert code == 2
    assert "run.py run mock/transient" in out


def test_every_verb_explains_itself_with_an_example(verb):
    for name in VERBS:
        code, out, _ = verb(name, "--help")
        assert code == 0
        assert "Example:" in out, name
        assert "--debug" in out, name


def test_an_unforeseen_error_is_one_line_and_shows_its_place_with_debug(verb, monkeypatch):
    def broken(*_):
        raise RuntimeError("the table\nis broken")

    monkeypatch.setattr("config.listing.listed_profiles", broken)
    code, _, err = verb("list")
    assert code == 1
    check_refusal(err, "unexpected RuntimeError: the table is broken", "--debug")
    with pytest.raises(RuntimeError):
        cli.main(["list", "--debug"], prog_name="run.py")


@pytest.mark.parametrize(
    "said", [MemoryError(), ImportError("libx.so: failed to map segment from shared object")]
)
def test_where_no_memory_is_left_the_line_says_so(verb, monkeypatch, said):
    def starved(*_):
        raise OSError("libllvmlite.so is not there") from said

    monkeypatch.setattr("config.listing.listed_profiles", starved)
    code, _, err = verb("list")
    assert code == 1
    check_refusal(err, "no memory is left", "raise its limit (ulimit -v)")


def test_a_reader_who_leaves_early_is_no_error():
    reading, writing = os.pipe()
    os.close(reading)
    with started("list", stdout=writing, stderr=subprocess.PIPE) as process:
        os.close(writing)
        assert process.communicate(timeout=PATIENCE_S)[1] == ""


# --- run, report, replay -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Two trials, run once for all tests that only look: the program's output, and the run's folder."""
    out = tmp_path_factory.mktemp("recorded")
    arguments = ["run", "mock/transient", "--only", "16", "--only", "17", "--out", str(out), *QUICK]
    command = [sys.executable, str(ROOT / "run.py"), *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    (folder,) = out.iterdir()
    return done, folder


@pytest.mark.parametrize("name", ["report", "open"])
def test_a_report_into_a_folder_that_may_only_be_read_gives_advice_that_works(
    verb, recorded, tmp_path, monkeypatch, name
):
    run = tmp_path / "run"
    shutil.copytree(recorded[1], run)
    (run / "report.html").unlink()
    monkeypatch.setattr("pyarrow.parquet.write_table", read_only)
    code, _, err = verb(name, run)
    assert code == 1
    check_refusal(err, "copy the run folder to one that may be written")
    monkeypatch.undo()
    monkeypatch.setattr(Path, "write_text", read_only)
    code, _, err = verb(name, run)
    assert code == 1
    check_refusal(err, "report.html", "copy the run folder to one that may be written")


def test_run_prints_each_trial_on_a_line_and_where_the_report_is(recorded):
    done, folder = recorded
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0].startswith("time: about 3.1 min of bench time, computed in ")
    assert lines[1] == f"Stop at first contact (A2), mock/transient: 2 trials into {folder}"
    assert {line.split()[2] for line in lines if line.startswith("[")} == {"16", "17"}
    assert lines[-2:] == [f"report: {folder / 'report.html'}", f"to see it: run.py open {folder}"]
    assert lines[-3].startswith(
        "Went well in simulation: 2 of 2 trials stopped at the contact; time from touch to detection "
    ), "the verdict comes last"
    assert any(line.split()[:3] == ["pad", "f", "4.84"] for line in lines), "Table I beside the paper's"
    assert "The guard had nothing to stop." in lines
    assert (folder / "report.html").is_file()
    assert json.loads((folder / "manifest.json").read_text())["exit"]["status"] == "done"


def test_open_prints_where_a_report_is_and_writes_one_where_there_is_none(verb, recorded, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    page = recorded[1] / "report.html"
    page.unlink(missing_ok=True)
    for _ in range(2):
        code, out, _ = verb("open", "latest", "--out", recorded[1].parent)
        assert (code, out.splitlines()[-1]) == (0, str(page))
        assert page.is_file()


def test_trials_from_a_file_are_run_in_their_order(verb, tmp_path):
    path = tmp_path / "trials.csv"
    path.write_text("location,speed_m_s,detectors.contact.sample_hz\nf,0.004,28\na,0.005,15\n")
    sets = [*QUICK, "--set", "trials.order=listed", "--set", "trials.repeats=1"]
    code, _, err = verb("run", "mock/transient", "--trials", path, "--out", tmp_path / "runs", *sets)
    assert (code, err) == (0, "")
    (folder,) = (tmp_path / "runs").iterdir()
    rows = (folder / "trials.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows[1:]] == ["1", "2"]
    assert "detectors.contact.sample_hz" in rows[0].split(",")


def test_a_device_that_fails_is_exit_code_3_with_one_line_and_a_report(verb, tmp_path):
    fault = 'faults=[{device = "stage", kind = "unplug", at_s = 1.0}]'
    code, out, err = verb("run", "mock/transient", "--only", 16, "--out", tmp_path, "--set", fault, *QUICK)
    assert code == 3
    check_refusal(err, "stage", "link is gone")
    assert "report: " in out


def test_a_folder_that_cannot_be_written_is_one_line_and_exit_code_1(verb, tmp_path):
    (tmp_path / "runs").write_text("a file, not a folder")
    code, _, err = verb("run", "mock/static", "--out", tmp_path / "runs")
    assert code == 1
    check_refusal(err, "runs")


# --- interrupting ------------------------------------------------------------------------------------

ENDLESS = ["run", "mock/transient", "--set", "trials.repeats=100", "--jobs", "1", "--no-report", *QUICK]
"""So many trials that no test sees the last one."""


def test_without_a_terminal_the_first_signal_aborts_with_130(tmp_path):
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with started(*ENDLESS, "--out", tmp_path, **streams) as process:
        while not process.stdout.readline().startswith("[1/"):
            assert process.poll() is None, process.stderr.read()
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert "interrupted" in err
    (folder,) = tmp_path.iterdir()
    assert json.loads((folder / "manifest.json").read_text())["exit"]["status"] == "aborted"


def test_on_a_terminal_ctrl_c_pauses_enter_resumes_and_twice_aborts(tmp_path):
    terminal = Terminal([*ENDLESS, "--out", str(tmp_path)])
    terminal.until(" of 1400 trials", PATIENCE_S)
    terminal.until("contact", PATIENCE_S)
    for key, answer in ((b"\x03", "Enter goes on"), (b"\n", "Ctrl+C pauses"), (b"\x03", "Enter goes on")):
        terminal.press(key)
        terminal.until(answer, PATIENCE_S)
    terminal.press(b"\x03")
    terminal.until("interrupted", PATIENCE_S)
    assert terminal.close() == 130
