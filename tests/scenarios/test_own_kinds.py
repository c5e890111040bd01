"""A detector, a signal, an experiment and a driver of the user's own, found beside the profile."""

import json
import re
import shutil
import sys
from pathlib import Path

import pytest

from config.assemble import plan_campaign
from config.jobs import Crew, Order, in_batches, order_of, run_batch
from config.profile import load_profile
from controller.console import Console
from controller.own_modules import forget_own
from controller.recording.reader import open_run
from controller.recording.run_folder import RunFolderError
from tests.refusals import check_refusal
from tests.scenarios.conftest import InTurn

DETECTOR = '''
"""Contact above a fixed force."""

import math

from behaviors.events import BaselineReady, Contact
from drivers.core.settings import Settings, StreamName


class EdgeSettings(Settings):
    input: StreamName = "board.load_cell"
    threshold_n: float = 0.1


class Edge:
    def __init__(self, name: str, settings: EdgeSettings) -> None:
        self.name, self.settings, self.inputs = name, settings, (settings.input,)
        self.reset()

    def reset(self):
        self._ready = self._contact = False

    def push(self, block):
        events = []
        for t_s, force_n in zip(block.times.tolist(), block.physical[:, 0].tolist(), strict=True):
            if not math.isfinite(force_n):
                continue
            if not self._ready:
                self._ready = True
                events.append(BaselineReady(t_s, self.name, 0.0, self.settings.threshold_n))
            elif force_n > self.settings.threshold_n and not self._contact:
                self._contact = True
                events.append(Contact(t_s, self.name, force_n, self.settings.threshold_n))
        return events
'''

EXPERIMENT = '''
"""Rest, and measure the force."""

from behaviors.machine import Behavior, StatePlan, on
from drivers.core.settings import Settings, StreamName

COLUMNS = ("force_n",)


class RestSettings(Settings):
    stream: StreamName = "board.load_cell"
    rest_s: float = 0.5


class RestFactors(Settings):
    number: int


class Rest(Behavior):
    table = (
        on("deadline", "RESTING", "DONE"),
    )

    def __init__(self, settings: RestSettings, factors: RestFactors, detectors: frozenset[str]) -> None:
        measured = frozenset({settings.stream})
        super().__init__({"RESTING": StatePlan(settings.rest_s, measures=measured)})

    def enter_DONE(self) -> None:
        self.conclude("rested")


def measure(evidence, settings, outcome):
    _, force_n = evidence.series(settings.stream)
    return outcome, {"force_n": float(force_n.mean())}
'''

SIGNAL = '''
"""A stream times two."""

import numpy as np

from touchbench import Settings, StreamInfo, StreamName


class DoubleSettings(Settings):
    input: StreamName = "board.load_cell"


class Double:
    def __init__(self, name, settings):
        self.name, self.inputs = name, (settings.input,)
        self.info = StreamInfo(f"signals.{name}", ("force",), "N")
        self.reset()

    def reset(self):
        self.count = 0

    def push(self, block):
        self.count += len(block)
        values = 2.0 * block.physical
        return [self.info.block(self.count - len(block), block.t0_s, values, times_s=block.times)]
'''

DEVICE = '''
"""A board by another name."""

from simulator.mocks.sensor_board import MockSensorBoard
from drivers.sensor_board.driver import SensorBoard


class Cell(SensorBoard):
    """Settings: those of the class from which it derives."""


class MockCell(MockSensorBoard):
    """Likewise."""
'''

PLANT = '''
"""The finger's bench, by another name."""

from simulator.physics.bench import Bench
from simulator.physics.finger_part import FingerBenchSettings, FingerPart


class SpongeSettings(FingerBenchSettings):
    depth_m: float = 0.01


class Sponge(Bench):
    def __init__(self, settings):
        super().__init__(settings, "probe")
        FingerPart(self, settings)
'''

TOUCH = """
extends = "mock/transient"

[detectors.contact]
kind = "my_lab.edge:Edge"
threshold_n = 0.2

[devices.board]
driver = "my_lab.cell:Cell"
port = "mock"

[trials]
repeats = 1
list = [ { location = "f", speed_m_s = 0.004 } ]
"""

REST = """
extends = "mock/bench_resonance"
experiment = "my_lab.rest:Rest"
title = "Rest"

[behavior]
rest_s = 0.25

[trials]
list = [ { number = 1 }, { number = 2 } ]
"""


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A folder with two profiles and what they name; the program is run from elsewhere."""
    (tmp_path / "lab" / "my_lab").mkdir(parents=True)
    for name, text in (
        ("touch.toml", TOUCH),
        ("rest.toml", REST),
        ("my_lab/edge.py", DETECTOR),
        ("my_lab/rest.py", EXPERIMENT),
        ("my_lab/cell.py", DEVICE),
        ("my_lab/double.py", SIGNAL),
        ("my_lab/sponge.py", PLANT),
    ):
        (tmp_path / "lab" / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "lab"


@pytest.fixture
def run_of(verb, lab):
    """Runs a profile of the lab; gives the run's folder."""

    def run(name, *sets, out="runs"):
        options = [part for each in sets for part in ("--set", each)]
        code, _, err = verb("run", lab / name, *options, "--out", out, "--no-report")
        assert code == 0, err
        (folder,) = lab.parent.glob(f"{out}/*")
        return folder

    return run


SOON = "behavior.settle_s=2.0"


def test_a_signal_of_the_users_own_is_what_its_detector_gets(run_of):
    twice = ("detectors.contact.input=signals.twice", "signals.twice.kind=my_lab.double:Double")
    run = run_of("touch.toml", SOON, *twice)
    events = [json.loads(line) for line in (run / "events.jsonl").read_text().splitlines()]
    (contact,) = (event for event in events if event["event"] == "Contact")
    assert contact["value"] > 0.2
    assert contact["state"] == "APPROACH"


def test_a_plant_of_the_users_own_is_what_is_touched_over_the_wire(lab, run_of):
    trial = '[trials]\nrepeats = 1\nlist = [ { location = "f", speed_m_s = 0.004 } ]\n'
    edge = 'extends = "emulated/transient"\n[detectors.contact]\nkind = "my_lab.edge:Edge"\n'
    (lab / "sponge.toml").write_text(edge + trial + '[plant]\nkind = "my_lab.sponge:Sponge"\n')
    run = run_of("sponge.toml", SOON, "plant.depth_m=0.02")
    assert json.loads((run / "manifest.json").read_text())["profile"]["resolved"]["plant"]["depth_m"] == 0.02
    assert (run / "trials.csv").read_text().splitlines()[1].startswith("1,contact,")


def test_a_plant_is_made_as_the_page_says(lab, run_of):
    page = (Path(__file__).parents[2] / "docs/how-to/add_a_device.md").read_text("utf-8")
    (code,) = re.findall(r"```python\n# my_bench/spring.py\n(.*?)```", page, re.DOTALL)
    (lab / "spring.py").write_text(code)
    run = run_of(
        "rest.toml", "plant.kind=spring:spring", "plant.surface_m=-0.001", "plant.stiffness_n_m=200.0"
    )
    _, first, *_ = (run / "trials.csv").read_text().splitlines()
    assert float(first.split(",")[-1]) == pytest.approx(200.0 * 0.001, abs=2e-4), "the tool rests 1 mm in it"


def test_what_is_no_bench_is_told(verb, lab):
    (lab / "my_lab" / "sponge.py").write_text(
        PLANT + "\n\nclass Sponge:\n    def __init__(self, settings):\n        pass\n"
    )
    code, _, err = verb("check", lab / "touch.toml", "--set", "plant.kind=my_lab.sponge:Sponge")
    assert code == 2
    check_refusal(err.splitlines()[-1], '[plant] kind = "my_lab.sponge:Sponge"', "has no advance")


def test_settings_of_the_users_own_are_held_against_the_rest_by_their_own_rule(verb, lab):
    rule = """
    def mismatches(self, path, profile):
        if profile["limits",].force_n < self.threshold_n:
            yield path, "threshold_n", " is above the guard's force; lower it"
"""
    path = lab / "my_lab" / "edge.py"
    path.write_text(
        path.read_text().replace("threshold_n: float = 0.1\n", "threshold_n: float = 0.1\n" + rule)
    )
    code, _, err = verb("check", lab / "touch.toml", "--set", "detectors.contact.threshold_n=900.0")
    assert code == 2
    check_refusal(err, "--set: [detectors.contact] threshold_n is above the guard's force; lower it")


def test_a_device_of_the_users_own_shows_its_lines_faults_and_those_that_its_twin_names(verb, lab):
    path = lab / "my_lab" / "cell.py"
    path.write_text(path.read_text() + "\n\nclass EmulatedCell:\n    faults = ('stall',)\n")

    def told(action, kind):
        fault = f'faults=[{{ device = "board", kind = "{kind}", at_s = 1.0 }}]'
        code, _, err = verb(action, lab / "touch.toml", "--set", fault, "--set", SOON)
        return code, err

    assert told("check", "stall") == (0, "")
    code, err = told("check", "overheat")
    assert (code, "it can show corrupt, drift, late, lose, silent, stall, stuck, unplug, wrong" in err) == (
        2,
        True,
    )
    code, err = told("run", "unplug")
    assert (code, "board failed: the link is gone (unplug" in err) == (3, True), (code, err)


def test_a_file_is_replayed_by_a_detector_that_is_found_in_the_present_folder(verb, lab, monkeypatch):
    monkeypatch.chdir(lab)
    rows = "\n".join(f"{0.01 * n:.2f},{0.0 if n < 5 else 1.0}" for n in range(10))
    (lab / "force.csv").write_text(f"t_s,force_n\n{rows}\n")
    code, out, err = verb("replay", "force.csv", "--detector", "my_lab.edge:Edge", "--set", "threshold_n=0.5")
    assert code == 0, err
    assert json.loads(out.splitlines()[-1])["t_s"] == pytest.approx(0.05)


def test_an_experiment_of_the_users_own_is_checked_run_and_reported(verb, lab, monkeypatch):
    assert verb("check", lab / "rest.toml")[0] == 0
    code, _, err = verb("run", lab / "rest.toml", "--out", "runs")
    assert code == 0, err
    (run,) = lab.parent.glob("runs/*")
    header, *rows = (run / "trials.csv").read_text().splitlines()
    assert header == "trial,outcome,number,force_n"
    assert len(rows) == 2
    forget_own()  # as a program that has not run it
    monkeypatch.undo()  # whose figures are drawn
    code, _, err = verb("report", run)
    assert code == 0, err
    assert "Mean ± standard deviation" in (run / "report.html").read_text("utf-8")
    assert "force, N" in (run / "figures" / "measured.svg").read_text("utf-8")


def test_a_worker_finds_what_the_profile_names(lab, run_of):
    alone = run_of("rest.toml", out="alone")
    profile = load_profile(lab / "rest.toml")
    plan = plan_campaign(profile, profile.trials(0), 0)
    crew = Crew(1, InTurn, lambda _: None)
    shared = in_batches(crew, profile, plan, Console(), lab.parent / "shared").run().folder
    assert (shared / "trials.csv").read_bytes() == (alone / "trials.csv").read_bytes()


@pytest.fixture
def helped(lab):
    """The lab's experiment, which imports a module that stands beside its profile."""
    (lab / "helper.py").write_text("FACTOR = 1.0\n")
    text = EXPERIMENT.replace("from behaviors", "import helper\nfrom behaviors")
    (lab / "my_lab" / "rest.py").write_text(text.replace(".mean()", ".mean() * helper.FACTOR"))
    return lab


def test_what_an_own_module_imports_of_its_folder_is_recorded_and_holds_a_resumed_run(verb, helped, run_of):
    run = run_of("rest.toml")
    assert set(json.loads((run / "manifest.json").read_text())["profile"]["own"]) == {"helper", "my_lab"}
    (helped / "helper.py").write_text("FACTOR = 2.0\n")
    forget_own()  # as a new program
    code, _, err = verb("resume", "latest")
    assert code == 2
    assert "own.helper" in err


def test_trials_of_a_worker_with_another_version_of_the_users_own_code_are_refused(helped, tmp_path):
    profile = load_profile(helped / "rest.toml")
    plan = plan_campaign(profile, profile.trials(0), 0)
    (helped / "helper.py").write_text("FACTOR = 2.0\n")
    outcome = in_batches(Crew(1, InTurn, lambda _: None), profile, plan, Console(), tmp_path / "out").run()
    assert isinstance(outcome.error, RunFolderError)
    assert "own.helper: " in outcome.line and "install the same one everywhere" in outcome.line
    assert not open_run(outcome.folder).trials


def test_a_worker_that_outlives_a_campaign_loads_own_code_anew(helped, tmp_path):
    def order() -> Order:
        forget_own()
        profile = load_profile(helped / "rest.toml")
        return order_of(profile, plan_campaign(profile, profile.trials(0), 0))

    first = order()
    trials = load_profile(helped / "rest.toml").trials(0)[:1]
    assert run_batch(first, trials, tmp_path).error == ""
    assert sys.modules["helper"].FACTOR == 1.0
    (helped / "helper.py").write_text("FACTOR = 2.0\n")
    second = order()
    assert run_batch(second, trials, tmp_path).error == ""
    assert sys.modules["helper"].FACTOR == 2.0


def test_a_run_is_not_resumed_by_another_version_of_the_users_own_code(verb, lab, run_of):
    run_of("rest.toml")
    assert "all 2 trials are done" in verb("resume", "latest")[1]
    (lab / "my_lab" / "rest.py").write_text(EXPERIMENT.replace("mean()", "max()"))
    code, _, err = verb("resume", "latest")
    assert code == 2
    assert "was run by another program (own.my_lab.sha256: " in err


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("my_lab.edge:", "must be MODULE:CLASS, as in my_lab.edge:Edge"),
        ("my_lab.ege:Edge", "no module my_lab.ege in "),
        ("nowhere:Edge", "no module nowhere in "),
        ("my_lab.edge:Egde", "edge.py has no Egde"),
        ("my_lab.rest:Rest", "is no detector: it has no push, reset"),
        ("my_lab.broken:Edge", "my_lab.broken cannot be imported: SyntaxError: "),
        ("my_lab.lacking:Edge", "cannot be imported: ModuleNotFoundError: No module named 'nothing_such' ("),
        ("my_lab.plain:Edge", "no EdgeSettings, a class of Settings, beside the class Edge"),
        ("my_lab.script:Edge", "my_lab.script cannot be imported: SystemExit: 3 ("),
        ("config:Edge", "the name config is taken by a module of the program"),
        ("my_lab.helped:Edge", "the name config is taken by a module of the program"),
    ],
)
def test_a_name_that_means_nothing_usable_is_one_line(verb, lab, kind, message):
    (lab / "my_lab" / "broken.py").write_text("class Edge:\n    def push(self\n")
    (lab / "my_lab" / "lacking.py").write_text("import nothing_such\n")
    (lab / "my_lab" / "script.py").write_text("raise SystemExit(3)\n")
    (lab / "my_lab" / "plain.py").write_text("class Edge:\n    push = reset = None\n")
    (lab / "my_lab" / "helped.py").write_text("from config import helper\n")
    (lab / "config").mkdir()
    code, _, err = verb("check", lab / "touch.toml", "--set", f"detectors.contact.kind={kind}")
    assert code == 2
    check_refusal(err, f'[detectors.contact] kind = "{kind}": ', message)


@pytest.mark.parametrize(
    ("right", "wrong", "named"),
    [
        ('("force_n",)', '("force_n")', ("COLUMNS = 'force_n'", "as (")),
        ('("force_n",)', '("force_n", "number")', ("called number", "factors")),
        ('("force_n",)', '("force_n", "outcome", "force_n")', ("called force_n, outcome",)),
        ("number: int", "number: int\n    trial: int = 1", ("called trial",)),
        ("COLUMNS = ", 'OUTCOMES = ["rested"]\nCOLUMNS = ', ("OUTCOMES = ['rested']", "success")),
        ("COLUMNS = ", 'OUTCOMES = {"rested": "yes"}\nCOLUMNS = ', ("OUTCOMES", "success")),
        ("settings, outcome):", "settings):", ("measure(evidence, settings, outcome)", "too many")),
    ],
)
def test_what_an_experiment_of_ones_own_declares_wrongly_is_refused_before_anything_moves(
    verb, lab, right, wrong, named
):
    assert right in EXPERIMENT
    (lab / "my_lab" / "rest.py").write_text(EXPERIMENT.replace(right, wrong))
    code, _, err = verb("run", lab / "rest.toml", "--no-report")
    assert code == 2
    check_refusal(err, "experiment", "rest.py", *named)
    assert not list(lab.parent.glob("runs/*"))


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ("None", ("measure returned None", "outcome")),
        ('{"force_n": 1.0}', ("measure returned {", "outcome")),
        ('None, {"force_n": 1.0}', ("measure returned (None", "outcome")),
        ('"Rested", {"force_n": 1.0}', ("the outcome 'Rested'", "OUTCOMES", "rested")),
        ('outcome, {"force": 1.0}', ("force", "COLUMNS", "force_n")),
    ],
)
def test_what_a_measure_of_ones_own_returns_is_held_against_what_its_module_declares(verb, lab, wrong, named):
    text = EXPERIMENT.replace("COLUMNS = ", 'OUTCOMES = {"rested": True}\nCOLUMNS = ')
    (lab / "my_lab" / "rest.py").write_text(
        text.replace('outcome, {"force_n": float(force_n.mean())}', wrong)
    )
    code, _, err = verb("run", lab / "rest.toml", "--no-report")
    assert code == 1
    check_refusal(err, "rest.py", *named)
    (row,) = next(lab.parent.glob("runs/*/trials.csv")).read_text().splitlines()[1:]
    assert row == "1,fault,1,", "what is not measured is no result"


def test_a_class_of_ones_own_that_ends_the_program_is_an_error_and_the_run_is_no_running_one(verb, lab):
    path = lab / "my_lab" / "edge.py"
    path.write_text(path.read_text().replace("        events = []\n", "        raise SystemExit(0)\n", 1))
    for action, more in (("run", ("--no-report", "--out", lab / "runs")), ("check", ())):
        code, _, err = verb(action, lab / "touch.toml", *more)
        assert code == 1
        check_refusal(err.splitlines()[-1], "edge.py, line", "sys.exit(0)")
    (run,) = lab.glob("runs/*")
    assert json.loads((run / "manifest.json").read_text())["exit"]["status"] == "failed"


def test_the_report_of_an_experiment_whose_module_is_gone_has_the_section_of_any(verb, lab, run_of):
    run = run_of("rest.toml")
    (lab / "my_lab" / "rest.py").rename(lab / "my_lab" / "moved.py")
    forget_own()  # as a new program
    code, _, err = verb("report", run)
    assert code == 0, err
    page = (run / "report.html").read_text("utf-8")
    assert "Mean ± standard deviation" in page
    assert "Its own module is not found (no module my_lab.rest in" in page
    code, _, err = verb("resume", run)
    assert code == 2, err


def test_a_method_imports_what_stands_beside_its_module_and_each_folder_has_its_own(verb, lab):
    text = EXPERIMENT.replace("    _, force_n", "    import helper\n\n    _, force_n")
    values = []
    for name in ("one", "two"):
        shutil.copytree(lab, lab.parent / name)
        (lab.parent / name / "helper.py").write_text(f"FACTOR = {len(values) + 1}\n")
        (lab.parent / name / "my_lab" / "rest.py").write_text(
            text.replace("float(force_n.mean())", "helper.FACTOR")
        )
        code, _, err = verb("run", lab.parent / name / "rest.toml", "--no-report", "--out", lab.parent / name)
        assert code == 0, err
        (table,) = (lab.parent / name).glob("*/trials.csv")
        values.append(table.read_text().splitlines()[1])
    assert values == ["1,rested,1,1", "1,rested,1,2"]


@pytest.mark.parametrize(
    ("module", "right", "wrong", "named"),
    [
        (
            "edge",
            "self.settings, self.inputs = name, settings, (settings.input,)",
            "self.settings = name, settings",
            "inputs",
        ),
        ("double", "self.info =", "self.inf =", "info"),
    ],
)
def test_what_an_object_of_ones_own_lacks_is_one_line(verb, lab, module, right, wrong, named):
    path = lab / "my_lab" / f"{module}.py"
    assert right in path.read_text()
    path.write_text(path.read_text().replace(right, wrong))
    twice = (
        "--set",
        "signals.twice.kind=my_lab.double:Double",
        "--set",
        "detectors.contact.input=signals.twice",
    )
    code, _, err = verb("check", lab / "touch.toml", *twice)
    assert code == 2, err
    check_refusal(err, 'kind = "my_lab.', f"has no {named}")


@pytest.mark.parametrize("action", ["run", "check"])
def test_a_device_of_ones_own_that_does_not_say_what_it_found_is_one_line(verb, lab, action):
    path = lab / "my_lab" / "cell.py"
    path.write_text(path.read_text() + "\n    def open(self):\n        super().open()\n")
    code, _, err = verb(action, lab / "touch.toml", *(("--out", lab / "runs") if action == "run" else ()))
    assert code == (1 if action == "run" else 2)
    check_refusal(err.splitlines()[-1], "devices.board", "open() returns None", "DeviceInfo")


@pytest.mark.parametrize("part", ["        self.reset()\n", "        events = []\n"])
def test_an_error_of_the_users_own_detector_is_reported_with_its_file_and_line(verb, lab, part):
    path = lab / "my_lab" / "edge.py"
    text = path.read_text()
    path.write_text(text.replace(part, part + "        1 / 0\n", 1))
    line = path.read_text().split("        1 / 0\n")[0].count("\n") + 1
    code, _, err = verb("run", lab / "touch.toml", "--no-report", "--out", lab / "runs")
    assert code == 1
    check_refusal(err, f"{path}, line {line}: ZeroDivisionError", "--debug")


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("detectors.contact.threshold=1.0", "did you mean 'threshold_n'?"),
        (
            "devices={ board = { port = 'emulated' }, stage = { port = 'emulated' } }",
            "cell.py has no EmulatedCell; its twin is EmulatedCell(settings, bench) beside it",
        ),
        ("devices.board.driver=my_lab.lone:Lone", "lone.py has no MockLone; its mock is MockLone(OverMemory"),
        ("devices.board.driver=my_lab.bare:Bare", "no MockBareSettings"),
    ],
)
def test_what_a_class_of_the_users_own_lacks_is_told(verb, lab, setting, said):
    (lab / "my_lab" / "lone.py").write_text("class Lone:\n    pass\n")
    parts = "open = close = apply = read = poll = account = None"
    (lab / "my_lab" / "bare.py").write_text(f"class MockBare:\n    {parts}\n")
    code, _, err = verb("check", lab / "touch.toml", "--set", "devices.board.port=mock", "--set", setting)
    assert code == 2
    check_refusal(err, said)
