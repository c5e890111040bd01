"""Libraries that a bench does not need, and modules that Linux alone has, made impossible to import."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.audio.recording import Recording
from drivers.audio.settings import AudioSettings
from drivers.core.can_link import CanPort, open_can
from drivers.core.clock import VirtualClock
from drivers.core.errors import PortError
from tests.refusals import check_refusal

ROOT = Path(__file__).parents[2]
EXTRAS = (
    *("rtde_control", "rtde_receive", "can", "sounddevice", "soundfile", "distributed", "foxglove"),
    *("pyarrow", "xarray", "nidaqmx", "grpc"),
)
LINUX = ("fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty")
NEXT = "--- the next verb ---"


def without(modules: tuple[str, ...], *verbs: list[str], folder: Path) -> str:
    """What the program prints in a folder, verb after verb in one process, the modules missing."""
    code = f"""
from run import cli
for place, arguments in enumerate({verbs!r}):
    print({NEXT!r} if place else "")
    try:
        cli(arguments)
    except SystemExit as ended:
        assert not ended.code, arguments
"""
    return python_without(modules, code, folder)


def python_without(modules: tuple[str, ...], code: str, folder: Path) -> str:
    missing = f"""
import os, sys
sys.path.insert(0, {str(ROOT)!r})
sys.modules.update(dict.fromkeys({modules!r}))
if "fcntl" in {modules!r}:
    for name in [name for name in dir(os) if name.startswith("sched_")]:
        delattr(os, name)
"""
    command = [sys.executable, "-c", missing + code]
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a run, made without any extra."""
    folder = tmp_path_factory.mktemp("missing")
    short = ("--only", "1", "--set", "behavior.settle_s=2.0", "--no-report")
    profile = "mock/transient"
    checked, ran = without(EXTRAS, ["check", profile], ["run", profile, *short], folder=folder).split(NEXT)
    assert 'experiment = "transient"' in checked
    assert "contact: 1" in ran
    return folder


READING = {
    ("report", "latest"): "report.html",
    ("compare", "latest", "latest"): "compare.html",
    ("export", "latest", "--to", "csv"): "samples_1.csv",
    ("export", "latest", "--to", "rosbag2"): "trial_1.mcap",
    ("replay", "latest", "--detector", "resonance.paper"): '"event": "Contact"',
    ("list", "slip"): "hardware/slip",
}
"""Verbs, and what each of them prints."""


def test_a_run_is_read_without_any_extra_and_without_what_linux_alone_has(folder: Path) -> None:
    printed = without((*EXTRAS, *LINUX), *map(list, READING), folder=folder).split(NEXT)
    for (arguments, expected), output in zip(READING.items(), printed, strict=True):
        assert expected in output, arguments


def test_a_script_reads_a_run_without_either(folder: Path) -> None:
    reading = """
from touchbench import open_run
run = open_run("latest")
series = run.trial(1).stream("board.load_cell")
print(run.trials[0]["outcome"], series.unit, len(series.times_s) == len(series.values) > 0)
"""
    assert python_without((*EXTRAS, *LINUX), reading, folder) == "contact N True\n"


SOUND = AudioSettings(port="file:a.wav")


@pytest.mark.parametrize(
    ("library", "extra", "open_it"),
    [
        ("can", "can", lambda: open_can("scale", CanPort(port="can0"), VirtualClock())),
        ("soundfile", "sound", lambda: Recording("scale", SOUND, VirtualClock(), "a.wav").open()),
    ],
)
def test_a_library_that_a_device_lacks_is_named_with_what_installs_it(
    monkeypatch: pytest.MonkeyPatch, library: str, extra: str, open_it: Callable[[], object]
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(PortError, match=rf"^scale: .*{library} is not installed .*'touchbench\[{extra}\]'$"):
        open_it()


@pytest.mark.parametrize("module", ["click", "transitions", "mcap"])
def test_a_python_without_the_program_s_libraries_is_told_in_one_line(module, tmp_path):
    """As of who calls `python run.py`, and means .venv/bin/python."""
    code = f"import sys; sys.modules[{module!r}] = None; from run import cli; cli()"
    command = [sys.executable, "-c", code, "run", "mock/static", "--only", "1", "--out", str(tmp_path)]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode
    check_refusal(ended.stderr, f"lacks {module}", ".venv/bin/python run.py")
