"""A bench of one's own by the tutorial: a stage of another pitch than the profile has, and a board that prints."""

import os
import re
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from config.assemble import start_emulator
from config.profile import load_profile
from simulator.wiring.emulator_process import EmulatorProcess
from tests.program import ROOT, Verb
from tests.refusals import check_refusal

STAGE = {
    "devices.board": "none",
    "devices.stage.microstep_m": "0.047625e-6",
    "detectors.ours": "none",
    "detectors.contact": '{ kind = "force.threshold", input = "stage.position", threshold = 1.0 }',
    "behavior.detector": "contact",
    "behavior.exciter": "none",
    "behavior.load_cell_stream": "none",
    "behavior.period_stream": "none",
    "limits.force_stream": "none",
    "limits.force_n": "none",
}
"""The far end of the stage: a profile of which only its emulated device is used."""


@pytest.fixture
def stage() -> Iterator[EmulatorProcess]:
    emulator = start_emulator(load_profile("emulated/transient", STAGE), realtime=True)
    yield emulator
    emulator.close()


@pytest.fixture
def arduino(stage: EmulatorProcess) -> Iterator[str]:
    """Prints `micros()` and the force of a spring that the probe meets at 3 mm: 1 N/mm, 100,000 steps a newton."""
    far, near = os.openpty()
    tty.setraw(near)
    os.set_blocking(far, False)
    ended = threading.Event()

    def loop() -> None:
        begun_s, tick, probe_m = time.monotonic(), 0, 0.0
        while not ended.wait(0.004):
            probe_m = stage.scene()["probe_m"]
            while tick < (time.monotonic() - begun_s) * 500.0:
                tick += 1
                force = 1e8 * max(0.0, probe_m - 0.003) + tick % 7
                with suppress(BlockingIOError):  # nobody reads: a port's buffer is full
                    os.write(far, b"%d,%d\r\n" % (tick * 2000, 8388 + force))

    thread = threading.Thread(target=loop, daemon=True)
    thread.start()
    yield os.ttyname(near)
    ended.set()
    thread.join()
    os.close(far)
    os.close(near)


def test_a_stage_and_a_printing_board_are_a_bench_by_the_page(
    stage: EmulatorProcess, arduino: str, tmp_path: Path, verb: Verb
) -> None:
    page = (ROOT / "docs" / "tutorial" / "first_run.md").read_text()
    (text,) = re.findall(r"```toml\n# my_bench/stage_and_cell\.toml\n(.*?)```", page, re.DOTALL)
    assert len(text.splitlines()) <= 40
    text = text.replace("/dev/serial/by-id/usb-MY_STAGE", stage.endpoints["devices"]["stage"]["port"])
    (tmp_path / "bench.toml").write_text(text.replace("/dev/serial/by-id/usb-MY_ARDUINO", arduino))

    # the machine may be busy: what is late here is no sensor's silence
    patient = ["limits.stale_s=5.0", "limits.late_s=5.0", "devices.cell.silence_timeout_s=5.0"]
    options = [tmp_path / "bench.toml", *(part for each in patient for part in ("--set", each))]
    code, out, _ = verb("check", *options, "--connect")
    assert code == 3
    (line,) = [line for line in out.splitlines() if " stage: " in f" {line}" and "limit.max of" in line]
    check_refusal(line, "limit.max", "microstep_m = 4.96094e-07", "4.763e-08", "data sheet")
    options += ["--set", "devices.stage.microstep_m=0.047625e-6"]
    code, out, err = verb("check", *options, "--connect")
    # a busy machine asks the stage for its position less often, which is told as lost samples
    fails = [line for line in out.splitlines() if line.startswith("fail")]
    assert [line for line in fails if "samples lost" not in line] == [], out + err
    assert code == (3 if fails else 0)
    assert "stage: Zaber device 1" in out
    run = subprocess.run(
        [sys.executable, str(ROOT / "run.py"), "run", *map(str, options)],
        cwd=tmp_path,
        input="\n" * 20,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    (folder,) = (tmp_path / "runs").iterdir()
    assert (folder / "trials.csv").read_text().splitlines()[1].startswith("1,contact,0.001,")
    assert "cell.force" in (folder / "report.html").read_text()
