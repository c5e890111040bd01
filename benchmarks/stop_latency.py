"""From the sample that decides to the stop command on the wire, and to standstill: real drivers, emulated devices.

The stage is at a pty, the arm behind ur_rtde and TCP on loopback. The arm's reaction to a command is that of an
emulated controller: no real one was at hand.
"""

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from behaviors.events import Contact, Detected, Event
from behaviors.machine import Behavior, StatePlan, on
from benchmarks.results import save
from config import assemble
from config.profile import load_profile
from controller.console import Console
from controller.guard import Guard
from controller.loop import Loop
from controller.recording.recorder import Recorder
from controller.recording.run_folder import RunFolder
from controller.rig import TrialScene
from drivers.core.clock import utc_now
from drivers.core.messages import Home, MoveAt, Reached, SampleBlock, Sent, Standstill, Stop

PROFILES = {"stage": "emulated/transient", "arm": "emulated/transient_arm"}
"""By the mover's name."""

STOPS = {"stage": 600, "arm": 200}
QUICK_STOPS = 60
SPEED_M_S = 0.005
MIDDLE_M = 0.002
"""Center of the motion: three times as far from either end as the travel between two stops."""

STREAM = "board.load_cell"


class AtRandom:
    """Reports contact 60 to 139 samples after the last one, at random: the decision itself is not measured here."""

    inputs = (STREAM,)

    def __init__(self, name: str) -> None:
        self.name = name
        self.arrivals_s: list[float] = []
        self._random = np.random.default_rng(1)
        self.reset()

    def reset(self) -> None:
        """Restart the count: every position in a block and in the loop's period occurs."""
        self._left = int(self._random.integers(60, 140))

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """One contact at the end of the count."""
        found = []
        for t_s in block.times.tolist():
            self._left -= 1
            if self._left == 0:
                self.reset()
                assert block.arrival_s is not None
                self.arrivals_s.append(block.arrival_s)
                found.append(Contact(t_s, self.name, 1.0, 0.0))
        return found


class BackAndForth(Behavior):
    """Moves, stops at a contact, moves the other way, some hundred times."""

    def __init__(self, mover: str, stops: int) -> None:
        listening = StatePlan(10.0, frozenset({"at_random"}))
        self._left = stops
        plans = {"HOMING": StatePlan(60.0), "MOVING": listening, "STOPPING": StatePlan(10.0)}
        super().__init__(plans, mover=mover)

    def enough(self) -> bool:
        """Whether the last stop has been made."""
        return self._left == 0

    def enter_HOMING(self) -> None:
        """Home the mover."""
        self.command(Home(self._mover))

    def enter_MOVING(self) -> None:
        """Towards the middle and beyond; a stop at standstill would show nothing."""
        assert isinstance(self.event, Reached | Standstill)
        forward = self.event.position_m < MIDDLE_M
        speed_m_s, until_m = (SPEED_M_S, 2.0 * MIDDLE_M) if forward else (-SPEED_M_S, 0.0)
        self.command(MoveAt(self._mover, speed_m_s, until_m))

    def enter_STOPPING(self) -> None:
        """Stop at once."""
        self._left -= 1
        self.command(Stop(self._mover))

    table = (
        on("reached", "HOMING", "MOVING"),
        on("contact", "MOVING", "STOPPING"),
        on("standstill", "STOPPING", "DONE", enough),
        on("standstill", "STOPPING", "MOVING"),
    )


def measure(mover: str, stops: int, realtime: bool = True) -> tuple[dict[str, list[float]], dict[str, Any]]:
    """Run the stops; returns seconds from the sample on, by part of the way, and the state of loop and link.

    Times from a sample are too short by the least delay of the board's link (see `drivers.core.clock_model`).

    Args:
        mover: Which.
        stops: How many.
        realtime: Whether bench time is wall time, so that the machine's own delays are measured.
    """
    profile = load_profile(PROFILES[mover], {})
    rig = assemble.build_rig(profile, realtime=realtime)
    detector = AtRandom("at_random")
    behavior = BackAndForth(mover, stops)
    with tempfile.TemporaryDirectory() as folder:
        try:
            infos = {name: device.open() for name, device in rig.devices.items()}
            streams = {stream: info for device in infos.values() for stream, info in device.streams.items()}
            run = RunFolder.create(Path(folder), "stop-latency", utc_now())
            recorder = Recorder(run, utc_now(), streams=streams, factors=(), measures=())
            recorder.begin_trial(1, {}, 0.0)
            rig.clock.restart()
            plant: Any = profile.plant
            rig.begin_trial(TrialScene(1, 1, {}, plant.settings.model_dump(mode="json")))
            loop = Loop(rig, infos, Guard(profile.limits), recorder, Console(), profile.loop)  # type: ignore[arg-type]
            account = loop.run(behavior, {"at_random": detector})
            recorder.close()
            link = dict(rig.devices[mover].account())
        finally:
            for device in rig.devices.values():
                device.close()
            rig.close()
    if behavior.state != "DONE":
        raise SystemExit(f"stop latency: {behavior.reason}")
    how = {
        "overruns": account.overruns,
        "worst_late_s": account.worst_late_s,
        "lost": account.lost,
        "link": link,
    }
    return _latencies(loop.events, detector.arrivals_s), how


def _latencies(events: Sequence[Event], arrivals_s: Sequence[float]) -> dict[str, list[float]]:
    decided: Event | None = None
    arrivals = iter(arrivals_s)
    ways = ("sample to host", "host to wire", "sample to wire", "wire to standstill", "sample to standstill")
    found: dict[str, list[float]] = {way: [] for way in ways}
    for event in events:
        if isinstance(event, Contact):
            arrival_s = next(arrivals)
            if decided is None:
                decided, arrived_s = event, arrival_s
        elif isinstance(event, Sent) and isinstance(event.command, Stop) and decided is not None:
            found["sample to host"].append(arrived_s - decided.t_s)
            found["host to wire"].append(event.t_s - arrived_s)
            found["sample to wire"].append(event.t_s - decided.t_s)
            sent_s = event.t_s
        elif isinstance(event, Standstill) and decided is not None:
            found["wire to standstill"].append(event.t_s - sent_s)
            found["sample to standstill"].append(event.t_s - decided.t_s)
            decided = None
    return found


def main(quick: bool = False, movers: Sequence[str] = tuple(PROFILES)) -> None:
    """Measure, print, save."""
    for mover in movers:
        stops = QUICK_STOPS if quick else STOPS[mover]
        latencies, how = measure(mover, stops)
        result: dict[str, Any] = {"stops": stops, **how, "block_samples": 10, "loop_hz": 200}
        for way, seconds in latencies.items():
            ms = np.array(seconds) * 1e3
            p50, p99 = np.percentile(ms, [50, 99])
            result[way] = {"p50_ms": p50, "p99_ms": p99, "max_ms": float(ms.max()), "n": len(ms)}
        save("stop_latency" if mover == "stage" else f"stop_latency_{mover}", result, quick=quick)


if __name__ == "__main__":
    asked = [name for name in sys.argv[1:] if name in PROFILES]
    main("--quick" in sys.argv, asked or tuple(PROFILES))
