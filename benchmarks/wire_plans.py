"""Plans of the swarm on the wire: emulated benches in wall time, whose emulators know where movers really are.

Each seed draws a plan as `run.py swarm` does, and with probability one half that a process is killed, stopped or gets
no more memory meanwhile: the program, the emulator, the arm's own process. Checked is what the emulator says of the
movers, the files of the run, and that it can be resumed. python -m benchmarks.wire_plans 0:100 --minutes 10
"""

import csv
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import click
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader

from benchmarks.results import ROOT, save
from config import assemble
from config.profile import Profile, load_profile
from config.swarm.plan import drawn
from controller.recording.run_folder import RunFolder
from drivers.core.errors import DeviceError
from simulator.wiring.emulator_process import EmulatorProcess

EXPERIMENTS = ("transient", "transient_arm", "static", "first_contact")
"""Whose plants say where the mover is (`probe_m`)."""

VICTIMS = ("program", "emulator", "arm")
ACTS = ("SIGKILL", "SIGSTOP", "no memory")
NO_MEMORY = ("MemoryError", "failed to map segment", "seems to be broken", "new thread", "bad_alloc")
"""How Python, the loader and the system say so."""

STOPPED_S = 2.0
"""How long a stopped process stands: longer than any watchdog here."""

LOOK_S = 0.02
SILENT_S, LONGEST_S = 60.0, 900.0
"""A run that writes nothing for so long, or goes on for so long, does not end: a busy machine slows all of it down."""

LEFT_S = 2.0
"""After its program's end a mover may go on for so long: longer than any watchdog here; then it stands for as long."""

STANDS_M = 1e-4
BEYOND_M = 5e-4
"""What a mover may be beyond its device's bounds: an arm's overshoot."""


class Act(NamedTuple):
    """What is done to a process, so long after the run has a folder."""

    victim: str
    what: str
    after_s: float


class Night(NamedTuple):
    """A plan on the wire, and how it ended: class and sentence, "" where all holds."""

    seed: int
    bench: str
    faults: str
    act: str
    code: int | None
    failure: str
    wall_s: float
    shown: int


def act_of(seed: int, bench: str) -> Act | None:
    """What is done to which process."""
    dice = random.Random(f"process {seed}")
    victim = dice.choice(VICTIMS if bench == "transient_arm" else VICTIMS[:2])
    act = Act(victim, dice.choice(ACTS), dice.uniform(0.0, 5.0))
    return act if dice.random() < 0.5 else None


def profile_of(seed: int, folder: Path) -> tuple[str, Path]:
    """The plan of a seed, as a profile of an emulated bench, and that one's name; what it cannot show is left out."""
    plan = drawn(seed, EXPERIMENTS)
    emulated = load_profile(f"emulated/{plan.experiment}", {})
    could = {(name, kind) for name, entry in emulated.devices.items() for kind in _kinds(entry.kind)}
    could.add(("disk", "slow"))
    faults = [fault for fault in plan.faults if (fault["device"], fault["kind"]) in could]
    settings = dict(plan.settings)
    settings.pop("devices.board.block_samples", None)  # of a board that is no mock the firmware says that
    if settings.pop("detectors.ours", None) is not None:
        settings["behavior.detector"] = "contact"
    text = replace(plan, settings=settings, faults=faults).toml()
    path = folder / "plan.toml"
    path.write_text(text.replace('extends = "mock/', 'extends = "emulated/'), encoding="utf-8")
    return plan.experiment, path


def _kinds(driver: str) -> tuple[str, ...]:
    from controller.registry import row

    return tuple(row("driver", driver).faults("emulated"))


def played(seed: int) -> Night:
    """Play one, and check it."""
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        bench, path = profile_of(seed, folder)
        profile = load_profile(str(path), {})
        act = act_of(seed, bench)
        told = f"{act.victim} {act.what} {act.after_s:.1f} s" if act else ""
        emulator = EmulatorProcess(assemble.emulator_scene(profile))
        try:
            code, output, places, after = watched(path, folder, emulator, act)
            shown = 0
            with suppress(DeviceError, OSError):
                shown = len(emulator.account().get("faults", ()))
        finally:
            _continued(emulator)
            emulator.close()
        failure = next(_failures(profile, folder, act, code, output, places, after), "")
        if not failure:
            failure = _resumed(profile, folder)
        faults = " ".join(f"{fault.device}:{fault.kind}" for fault in profile.faults)
        return Night(seed, bench, faults, told, code, failure, time.monotonic() - began_s, shown)


def watched(
    path: Path, folder: Path, emulator: EmulatorProcess, act: Act | None
) -> tuple[int | None, str, list[float], list[float]]:
    """Run it: exit code, output, where the mover was, and where from `LEFT_S` after the end."""
    places: list[float] = []
    after: list[float] = []
    program = started(folder, emulator, "run", str(path), "--out", str(folder / "runs"))
    begun_s = acted_s = stands_s = None
    goes_on = _Patience(folder)
    while program.poll() is None and goes_on():
        now_s = time.monotonic()
        if begun_s is None and list((folder / "runs").glob("*/manifest.json")):
            begun_s = now_s
        if act and begun_s is not None and acted_s is None and now_s > begun_s + act.after_s:
            acted_s = now_s
            stands_s = _sent(act, program, emulator)
        if stands_s is not None and now_s > acted_s + STOPPED_S:  # type: ignore[operator]
            with suppress(ProcessLookupError):
                os.kill(stands_s, signal.SIGCONT)
            stands_s = None
        if not (act and act.victim == "emulator" and acted_s is not None):
            places += _place(emulator)
    code = program.poll()
    said = ended(program, folder)
    if not (act and act.victim == "emulator" and acted_s is not None):
        time.sleep(LEFT_S)
        for _ in range(round(LEFT_S / LOOK_S)):
            after += _place(emulator)
            time.sleep(LOOK_S)
    return code, said, places + after, after


def started(folder: Path, emulator: EmulatorProcess, *arguments: str) -> subprocess.Popen[Any]:
    """The program, on an emulator's devices; what it says is in the folder's file `output`."""
    endpoints = folder / "endpoints.json"
    endpoints.write_text(json.dumps(emulator.endpoints), encoding="utf-8")
    command = [
        sys.executable,
        "run.py",
        *arguments,
        "--no-report",
        "--jobs",
        "1",
        "--endpoints",
        str(endpoints),
    ]
    with (folder / "output").open("w", encoding="utf-8") as output:
        return subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT
        )


def ended(program: subprocess.Popen[Any], folder: Path) -> str:
    """What it said, once it has ended, or is killed."""
    program.kill()
    program.wait()
    return (folder / "output").read_text(encoding="utf-8")


class _Patience:
    """Looks, each `LOOK_S`, whether what is in a folder still grows."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._size = folder, 0
        self._begun_s = self._grown_s = time.monotonic()

    def __call__(self) -> bool:
        time.sleep(LOOK_S)
        size, now_s = (
            sum(path.stat().st_size for path in self._folder.rglob("*") if path.is_file()),
            time.monotonic(),
        )
        if size != self._size:
            self._size, self._grown_s = size, now_s
        return now_s < min(self._begun_s + LONGEST_S, self._grown_s + SILENT_S)


def _sent(act: Act, program: subprocess.Popen[Any], emulator: EmulatorProcess) -> int | None:
    """Do it; the process that is to go on later."""
    victims = {"program": program.pid, "emulator": emulator._child.pid, "arm": _arm_of(program.pid)}
    victim = victims[act.victim]
    if victim is None:
        return None
    with suppress(ProcessLookupError):
        if act.what == "no memory":
            pages = int(Path(f"/proc/{victim}/statm").read_text(encoding="ascii").split()[0])
            limits = pages * resource.getpagesize(), resource.RLIM_INFINITY
            resource.prlimit(victim, resource.RLIMIT_AS, limits)
        else:
            os.kill(victim, signal.Signals[act.what])
    return victim if act.what == "SIGSTOP" else None


def _arm_of(pid: int) -> int | None:
    """The arm's process of a program."""
    with suppress(OSError):
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split():
            if b"drivers.arm.process" in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
    return None


def _continued(emulator: EmulatorProcess) -> None:
    with suppress(ProcessLookupError):
        os.kill(emulator._child.pid, signal.SIGCONT)


def _place(emulator: EmulatorProcess) -> list[float]:
    with suppress(DeviceError, OSError, ValueError):
        return [emulator.scene()["probe_m"]]
    return []


def _failures(
    profile: Profile,
    folder: Path,
    act: Act | None,
    code: int | None,
    output: str,
    places: list[float],
    after: list[float],
) -> Iterator[str]:
    """What does not hold."""
    killed = act is not None and act.victim == "program" and act.what == "SIGKILL"
    last = (output.strip().splitlines() or [""])[-1]
    starved = act is not None and act.what == "no memory" and any(word in output for word in NO_MEMORY)
    if ("Traceback" in output or "unexpected" in output) and not starved:
        yield f"CRASH: {last}"
    if code is None:
        yield f"LIVENESS: it does not end, and has written nothing for {SILENT_S:g} s: {last}"
    if code not in (0, 1, 3, 4, 130, -signal.SIGKILL if killed else 0):
        yield f"CRASH: exit code {code}: {last}"
    mover: Any = profile.devices[getattr(profile.behavior, "mover", "stage")].settings
    least_m = getattr(mover, "travel_min_m", 0.0) - BEYOND_M
    most_m = getattr(mover, "travel_max_m", getattr(mover, "travel_m", 0.0)) + BEYOND_M
    if places and not least_m <= min(places) <= max(places) <= most_m:
        yield f"SAFETY: the mover was at {min(places):.4f} .. {max(places):.4f} m"
    if after and max(after) - min(after) > STANDS_M and not _lost(profile):
        yield f"SAFETY: it moves on, {LEFT_S:g} s after the end: by {max(after) - min(after):.5f} m"
    runs = sorted((folder / "runs").glob("*/manifest.json"))
    if not runs:
        return
    manifest = json.loads(runs[0].read_text(encoding="utf-8"))
    if not killed and manifest["exit"]["status"] == "running" and code is not None:
        yield "DATA: the manifest says that it still runs"
    yield from _rows(manifest, runs[0].parent, code)


def _lost(profile: Profile) -> bool:
    """Whether the mover's own line may have been cut off: then its device alone bounds it."""
    return any(fault.device in ("stage", "arm") for fault in profile.faults)


def _rows(manifest: Mapping[str, Any], run: Path, code: int | None) -> Iterator[str]:
    rows: list[dict[str, str]] = []
    with suppress(FileNotFoundError), (run / "trials.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    if any(not row["outcome"] for row in rows):
        yield "DATA: a row without an outcome"
    if code == 0 and len(rows) != manifest["trials"]:
        yield f"DATA: {len(rows)} rows of {manifest['trials']} trials, and exit code 0"
    for path in run.glob("*.mcap"):
        try:
            with path.open("rb") as file:
                for _ in NonSeekingReader(file, validate_crcs=True).iter_messages():
                    pass
        except McapError as error:
            if code is not None and code >= 0:
                yield f"DATA: {path.name}: {error}"


def _resumed(profile: Profile, folder: Path) -> str:
    """Nothing goes wrong any more: what broke off is resumed, and ends."""
    runs = list((folder / "runs").glob("*/manifest.json"))
    if not runs or not RunFolder(runs[0].parent).begun:  # no device could be opened: nothing to resume
        return ""
    manifest = json.loads(runs[0].read_text(encoding="utf-8"))
    manifest["profile"]["resolved"]["faults"] = []  # healed: of the same profile, without what went wrong
    runs[0].write_text(json.dumps(manifest), encoding="utf-8")
    plan = folder / "plan.toml"
    lines = plan.read_text(encoding="utf-8").splitlines(keepends=True)
    plan.write_text("".join(line for line in lines if not line.startswith("faults")), encoding="utf-8")
    emulator = EmulatorProcess({**assemble.emulator_scene(profile), "faults": []})
    try:
        program = started(folder, emulator, "resume", "latest", "--out", str(folder / "runs"))
        goes_on = _Patience(folder)
        while program.poll() is None and goes_on():
            pass
        code = program.poll()
        last = (ended(program, folder).strip().splitlines() or [""])[-1]
    finally:
        emulator.close()
    if code is None:
        return f"LIVENESS: what was resumed does not end: {last}"
    own_limit = code == 4 and "limits.force_n" in last  # which was drawn, and may be too low
    return "" if code in (0, 1) or own_limit else f"LIVENESS: resumed: exit code {code}: {last}"


SOAKED = (
    ("board", "lose", 0.02),
    ("board", "double", 0.03),
    ("board", "corrupt", 0.01),
    ("board", "silent", 0.3),
    ("stage", "double", 0.05),
)
"""What goes wrong in a soak, for how long, s: bytes lost, doubled, altered, and a board that is silent too long."""

BETWEEN_S = (3.0, 30.0)
"""How long nothing goes wrong: between these, uniform."""


def soaked(minutes: float) -> dict[str, Any]:
    """One run that goes on for so long, its trials repeated after faults; memory of program and emulator, MB, and where
    the mover was, m."""
    sets = {"trials.repeats": "1000", "trials.reconnects": "1000", "behavior.settle_s": "2.0"}
    profile = load_profile("emulated/transient", sets)
    emulator = EmulatorProcess(assemble.emulator_scene(profile))
    memory: dict[str, list[float]] = {"program": [], "emulator": []}
    places: list[float] = []
    with tempfile.TemporaryDirectory() as text:
        given = (f"--set={key}={value}" for key, value in sets.items())
        program = started(Path(text), emulator, "run", "emulated/transient", "--out", text, *given)
        dice, injected = random.Random("soak"), Counter[str]()
        end_s, look_s, wrong_s = time.monotonic() + 60.0 * minutes, 0.0, time.monotonic() + BETWEEN_S[1]
        while program.poll() is None and time.monotonic() < end_s:
            places += _place(emulator)
            if time.monotonic() > wrong_s:
                wrong_s = time.monotonic() + dice.uniform(*BETWEEN_S)
                device, kind, for_s = dice.choice(SOAKED)
                emulator.inject(device, kind, for_s=for_s)
                injected[f"{device} {kind}"] += 1
            if time.monotonic() > look_s:
                look_s = time.monotonic() + 10.0
                for name, pid in (("program", program.pid), ("emulator", emulator._child.pid)):
                    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
                    memory[name].append(pages * os.sysconf("SC_PAGE_SIZE") / 1e6)
            time.sleep(0.1)
        alive = program.poll() is None
        program.terminate()
        program.wait()
        emulator.close()
        said = ended(program, Path(text))
        rows = next(Path(text).glob("*/trials.csv")).read_text(encoding="utf-8").splitlines()[1:]
    return {
        "minutes": minutes,
        "alive": alive,
        "last": said.strip().splitlines()[-1],
        "injected": dict(injected),
        "reconnected": said.count("; reconnected"),
        "outcomes": dict(Counter(row.split(",")[1] for row in rows)),
        "memory_mb": memory,
        "places_m": [min(places), max(places)],
    }


@click.command()
@click.argument("seeds", default="0:100")
@click.option("--minutes", default=10.0, show_default=True, help="Begin no plan after so many.")
@click.option("--soak", default=0.0, help="In place of plans one run of so many minutes.")
def main(seeds: str, minutes: float, soak: float) -> None:
    """Play, count, print, save."""
    if soak:
        found = soaked(soak)
        print(found)
        save("wire_soak", found)
        sys.exit(not found["alive"])
    first, last = map(int, seeds.split(":"))
    end_s = time.monotonic() + 60.0 * minutes
    nights: list[Night] = []
    for seed in range(first, last):
        if time.monotonic() > end_s:
            break
        nights.append(played(seed))
        print(nights[-1], flush=True)
    codes = Counter(str(night.code) for night in nights)
    played_ones = [night._asdict() for night in nights]
    save("wire_plans", {"seeds": [first, first + len(nights)], "codes": dict(codes), "nights": played_ones})
    sys.exit(any(night.failure for night in nights))


if __name__ == "__main__":
    main()
