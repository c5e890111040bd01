"""Whole runs with the fingers' sound, by the command line: mock, emulated and from a file."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from tests.program import Verb

PROFILE = """
title = "A sweep"
experiment = "chirp"
[devices.audio]
driver = "audio"
port = "{port}"
[behavior]
duration_s = 0.6
[limits]
travel_m = 0.06
position_stream = "none"
force_stream = "none"
[trials]
list = [{{}}]
[plant]
{plant}
"""

AURA = 'kind = "aura"\nlevel = "carrier"\nobject = "none"'


def profile(folder: Path, port: str, plant: str = AURA) -> Path:
    path = folder / "sweep.toml"
    path.write_text(PROFILE.format(port=port, plant=plant))
    return path


def recording(path: Path) -> Path:
    noise = np.random.default_rng(2).normal(0.0, 1e-3, (4 * 96_000, 2))
    soundfile.write(path, noise, 96_000, subtype="PCM_24")
    return path


def manifest(folder: Path) -> Any:
    (run,) = folder.iterdir()
    return json.loads((run / "manifest.json").read_text())


@pytest.mark.parametrize("port", ["mock", "emulated"])
def test_a_sweep_finds_the_fingers_resonance_and_an_emulated_link_is_in_the_manifest(
    tmp_path: Path, verb: Verb, port: str
) -> None:
    code, _, _ = verb("run", profile(tmp_path, port), "--no-report", "--out", tmp_path / "runs")
    assert code == 0
    (run,) = (tmp_path / "runs").iterdir()
    names, values = (line.split(",") for line in (run / "trials.csv").read_text().splitlines())
    found = dict(zip(names, values, strict=True))
    # The plant's fingers resonate near 40 kHz.
    assert float(found["best_hz"]) == pytest.approx(40_000.0, abs=1000.0)
    if port == "mock":
        return
    recorded = manifest(tmp_path / "runs")
    assert recorded["devices"]["audio"]["clock"] == "audio frames"
    link = recorded["devices"]["audio"]["link"]
    assert link["frames"] + link["frames_lost"] >= 0.6 * 96_000
    assert recorded["loss"].get("audio.fingers", 0) == link["frames_lost"]


def test_a_recording_runs_in_the_fingers_place(tmp_path: Path, verb: Verb) -> None:
    path = profile(tmp_path, f"file:{recording(tmp_path / 'take.wav')}", 'kind = "none"')
    code, _, _ = verb("run", path, "--no-report", "--out", tmp_path / "runs")
    assert code == 1, "noise has no echo"
    recorded = manifest(tmp_path / "runs")
    assert recorded["devices"]["audio"]["drive"] == "as recorded"
    assert recorded["outcomes"] == {"no_echo": 1}


def test_check_connects_and_reads_both_fingers(tmp_path: Path, verb: Verb) -> None:
    path = profile(tmp_path, f"file:{recording(tmp_path / 'take.wav')}", 'kind = "none"')
    code, out, _ = verb("check", path, "--connect")
    assert code == 0
    assert "audio: WAV recording take.wav" in out
    # A program that was held up has listened for longer.
    assert re.search(
        r"audio\.fingers: \d{5,6} samples in 1 s, right .* \+- 0\.001, left .* \+- 0\.001 FS", out
    )
