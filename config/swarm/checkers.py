"""What must hold of a played plan, whatever went wrong in it: from the bench's truth and the files alone.

Nothing of the program is imported here, least of all of its guard: a checker that shared a mistake would not see it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.exceptions import EndOfFile, McapError
from mcap.stream_reader import StreamReader

BRAKING_S = 0.35
"""How long after a stop a mover may still move: an arm at 0.25 m/s brakes with 1 m/s2; and two turns of the loop."""

WAY_OUT_S = 10.0 + 3.0
"""How long a way out of a trial that was ended may take, and a mover to be seen standing still."""

MOVES = re.compile("Move|Twist|Home|Stop|Grip|Release")
"""Commands that a mover answers."""

STILL_M_S = 2e-5
"""What counts as standing still: below a stage's microstep in a turn."""

BRAKES_S = 0.1
"""Likewise of an axis at its approaching speed, at most 50 mm/s."""

OVER_M = 0.0015
"""How far beyond its limits a mover may come to stand. Assumption: what a stage travels in two turns at 50 mm/s, and
brakes."""

BLIND_M = 0.0035
"""How far a mover may go that nobody reaches: its device's blind travel of 2 mm, and braking."""

OVER_SHARE = 1.1
"""From which share of the limit on a force is certainly seen: noise may hide less."""

LATE_S = 0.05
"""By how much a device is late whose fault does not say."""

FAR_LOOKS = 6
"""So many looks in a row at a rattling finger that are far apart are not beyond a limit by chance."""

OVER_S = 1.0
"""How long after a line is there again its mover is reached as ever: an unanswered stop was sent again by then."""

CLOSES_ITSELF = ("CALIBRATING", "HOMING")
"""States in which a gripper finds its ends by itself, jaw against jaw, as hard as its maker has set it."""

SAME_TIME_S = 1e-6
"""How far a sample's time may be from the bench's own. A bench in the process states no error: a microsecond is the
resolution of what is written."""

SUCCESSES = (
    "contact",
    "recorded",
    "approached",
    "centered",
    "held",
    "swept",
    "calibrated",
    "located",
    "gripped",
)
"""Outcomes that a report counts as success."""

NO_DEVICES = ("loop", "keys", "disk")
"""What goes wrong and is no device."""

HARMLESS = {"pause", "slow"}
"""What spoils no trial: a person's pause, and a disk that takes its time."""

CUT = ("silent", "unplug", "lose", "corrupt")
"""Kinds of faults by which samples do not come."""

DECIDING = (
    "RECORDING",
    "APPROACH",
    "APPROACHING",
    "SWEEPING",
    "SEEKING_FORWARD",
    "SEEKING_BACKWARD",
    "SLIPPING",
)
"""States of which a part that did not come is no result. In others a hole may be shorter than what is measured."""

EXITS = (0, 1, 2, 3, 4, 130)
"""Exit codes that the reference of the command line documents."""


ENDING = ("GuardStopped", "Failed", "Stalled")
"""Events that end a trial, whatever its behavior makes of them."""

AT_ONCE_S = 2.0 * 2.0 + 1.0
"""How long a trial that nothing leads out of may take to its end: movers are looked at twice, for two seconds."""


class Violation(NamedTuple):
    """What does not hold."""

    end: str
    checker: str
    trial: int | None
    t_s: float | None
    state: str
    what: str


def check(story: Any) -> Iterator[Violation]:
    """What does not hold of one played plan; see `config.swarm.play.Story`."""
    if story.error is not None:
        end = "LIVENESS" if type(story.error).__name__ == "EndlessError" else "CRASH"
        yield Violation(end, "raised", *_where(story), f"{type(story.error).__name__}: {story.error}")
        return
    for checker in CHECKERS:
        try:
            yield from checker(story)
        except (ValueError, KeyError, TypeError) as error:  # files that are not as they are described
            what = f"{checker.__name__}: {type(error).__name__}: {error}"
            yield Violation("DATA", "files", *_where(story), what)


def _where(story: Any) -> tuple[int | None, float | None, str]:
    if not story.trials:
        return None, None, ""
    trial = story.trials[-1]
    t_s = trial.samples[-1][0] if trial.samples else None
    return trial.number, t_s, state_at(trial, t_s)


def state_at(trial: Any, t_s: float | None) -> str:
    """The state that a trial was in; the last one where no time is given."""
    names = [name for name, since_s in trial.states if t_s is None or since_s <= t_s + 1e-9]
    return names[-1] if names else ""


# --- data ------------------------------------------------------------------------------------------


def _exit(story: Any) -> Iterator[Violation]:
    if story.exit_code not in EXITS:
        yield Violation("DATA", "exit", *_where(story), f"exit code {story.exit_code}")
    if story.exit_code and not story.line:
        yield Violation("DATA", "exit", *_where(story), "it ended badly and says nothing")
    kinds = {effect["kind"] for effect in story.effects}
    if "abort" in kinds and story.exit_code != 130 and "full" not in kinds:  # a full disk is the graver end
        yield Violation(
            "LIVENESS", "exit", *_where(story), f"it was interrupted; exit code {story.exit_code}"
        )
    if kinds <= HARMLESS and story.exit_code not in (0, 1) and not _of_drawn(story):
        what = f"nothing is wrong with the bench; exit code {story.exit_code}: {story.line}"
        yield Violation("LIVENESS", "exit", *_where(story), what)
    status = story.manifest["exit"]["status"]
    if status == "running":
        yield Violation("DATA", "exit", *_where(story), "the manifest says that it still runs")


def _of_drawn(story: Any) -> bool:
    """Whether what was drawn ended the run: a limit that every trial meets, a loop too slow for an approach."""
    pairs = {
        "limits.force_n": ("limits.force_n",),
        "limits.peak_n": ("loop.rate_hz", "limits.force_n", "limits.force_median_s"),
    }
    settings = story.plan.settings
    return any(
        limit in story.line and any(map(settings.__contains__, drawn)) for limit, drawn in pairs.items()
    )


def _full(story: Any) -> bool:
    return any(effect["kind"] == "full" for effect in story.effects)


def _rows(story: Any) -> Iterator[Violation]:
    """A row for each trial that ended, with an outcome, and success only where there was one."""
    numbers = [int(row["trial"]) for row in story.rows]
    begun = [trial.number for trial in story.trials]
    if _full(story):  # what was written before stands
        if story.exit_code not in (1, 130) or (story.exit_code == 1 and "No space left" not in story.line):
            what = f"the disk was full; exit code {story.exit_code}: {story.line}"
            yield Violation("DATA", "disk", *_where(story), what)
        if numbers not in (begun, begun[:-1]):
            yield Violation("DATA", "rows", *_where(story), f"rows of trials {numbers}, begun were {begun}")
        return
    if numbers != begun:
        yield Violation("DATA", "rows", *_where(story), f"rows of trials {numbers}, begun were {begun}")
    for row in story.rows:
        if not row["outcome"] or row["outcome"] == "undecided":
            yield Violation("DATA", "rows", int(row["trial"]), None, "", f"outcome '{row['outcome']}'")
        for name, cell in row.items():
            if cell and cell.lower() in ("nan", "inf", "-inf"):
                yield Violation("DATA", "rows", int(row["trial"]), None, "", f"{name} = {cell}")
    counted = sum(story.manifest["outcomes"].values())
    if counted != len(numbers):
        yield Violation("DATA", "rows", *_where(story), f"{len(numbers)} rows, the manifest counts {counted}")


BAD = {"guard": 4, "fault": 3}
"""Outcomes that end a run, and its exit code."""


def _outcomes(story: Any) -> Iterator[Violation]:
    """What ended badly ends the run, by its exit code; what was interrupted is no success."""
    for row in story.rows[:-1]:
        if row["outcome"] in BAD:
            what = f"another trial began after one that ended as {row['outcome']}"
            yield Violation("SAFETY", "outcomes", int(row["trial"]), None, "", what)
    for row in story.rows:
        if row["outcome"] in BAD and story.exit_code not in (BAD[row["outcome"]], 130):
            what = f"{row['outcome']}, exit code {story.exit_code}"
            yield Violation("DATA", "outcomes", int(row["trial"]), None, "", what)
    if story.exit_code == 130 and story.rows:
        last, told = story.rows[-1], story.trials[-1].outcome  # told of a trial that had ended before
        if last["outcome"] not in ("aborted", *BAD) and not told:
            what = f"the trial was interrupted; its outcome is {last['outcome']}"
            yield Violation("DATA", "outcomes", int(last["trial"]), None, "", what)


def _ended(story: Any) -> Iterator[Violation]:
    """A trial that the guard stopped, or in which a device failed or stalled, ends as that: never as anything else."""
    outcomes = {int(row["trial"]): row["outcome"] for row in story.rows}
    full = _full(story)
    pressed = any(effect["kind"] == "abort" for effect in story.effects)
    person = story.profile["behavior"].get("operator")
    for event in story.events():
        number = event.get("trial")
        if full and number not in outcomes:
            return
        declined = event.get("event") == "Refused" and event["device"] == person  # who may want no more
        allowed = ("guard", "fault", *(("aborted",) if pressed or declined else ()))
        refused = (
            event.get("event") == "Refused" and event["next"] != event["state"]
        )  # no pause had taken its place
        # what comes after the end, while everything is seen to stand still, ends no trial any more
        if (refused or event.get("event") in ENDING) and event["state"] not in ("DONE", "FAILED"):
            if outcomes.get(number) not in allowed:
                what = (
                    f"{event['event']}: {event.get('reason', '')[:80]}; the outcome is {outcomes.get(number)}"
                )
                yield Violation("DATA", "ended", number, event["t_s"], event["state"], what)
            return


def _touched(story: Any) -> Iterator[Violation]:
    """A contact is of a touch, and none that came after the touch is called false: where the row knows the truth."""
    rows = {int(row["trial"]): row for row in story.rows if row.get("detect_s")}
    for trial in story.trials:
        if trial.number not in rows or trial.touched_s is None or "truth_contact_s" not in rows[trial.number]:
            continue
        outcome, told_s = rows[trial.number]["outcome"], float(rows[trial.number]["detect_s"])
        if outcome in ("contact", "false_contact") and (outcome == "contact") != (trial.touched_s <= told_s):
            what = f"{outcome}, told at {told_s:.4f} s; it was touched first at {trial.touched_s:.4f} s"
            yield Violation("DATA", "touched", trial.number, told_s, state_at(trial, told_s), what)


def _spared(story: Any) -> Iterator[Violation]:
    """Where nothing is wrong but what is harmless, no trial is given up, but for what cannot be slipped over twice."""
    if (
        story.plan.experiment != "slip"
        and {effect["kind"] for effect in story.effects} <= HARMLESS
        and story.exit_code in (0, 1)
    ):
        for row in story.rows:
            if row["outcome"] == "aborted":
                what = f"nothing is wrong with the bench, and it ended as {row['outcome']}"
                yield Violation("LIVENESS", "spared", int(row["trial"]), None, "", what)


def _named(story: Any) -> Iterator[Violation]:
    """Where one device alone failed, the line that ends the run names it."""
    devices = {effect["device"] for effect in story.effects}
    if story.exit_code == 3 and len(devices) == 1:
        (device,) = devices
        if device not in NO_DEVICES and device not in story.line:
            yield Violation("DATA", "named", *_where(story), f"{device} failed; it says: {story.line}")


def _required(story: Any) -> Iterator[Violation]:
    """No success where a stream that a state measures did not come for a part of it."""
    movers = [story.profile["behavior"].get(key) for key in ("mover", "gripper")]
    outcomes = {int(row["trial"]): row["outcome"] for row in story.rows}
    for trial in story.trials:
        if outcomes.get(trial.number) not in SUCCESSES:
            continue
        for effect in story.effects:
            if effect["trial"] != trial.number or effect["kind"] not in CUT or "every_s" in effect:
                continue
            ends_s, again_s = _ends_s(effect, trial), _again_s(trial)
            # a mover's positions have no numbers by which a loss shows: what is missing may be in transit for as long
            hole_s = 0.1 if effect["device"] in movers else 0.06
            for state, since_s, until_s in _spans(trial):
                cut_s = min(until_s, ends_s) - max(since_s, effect["effect_s"], again_s)
                # the first look at a device may come long after its samples are due: count from there
                if state in DECIDING and cut_s > hole_s and effect["device"] in story.measured.get(state, ()):
                    yield Violation(
                        "DATA",
                        "required",
                        trial.number,
                        effect["effect_s"],
                        state,
                        f"{outcomes[trial.number]}, though {effect['device']} was {effect['kind']} for {cut_s:.3f} s",
                    )


def _ends_s(effect: Mapping[str, Any], trial: Any) -> float:
    """Until when a fault that is not repeated lasts: it may have begun long before it took effect."""
    entered = [since_s for name, since_s in trial.states if name == effect.get("after")]
    begun_s = max((each_s for each_s in entered if each_s <= effect["effect_s"] + 1e-9), default=0.0)
    begins_s = min(begun_s + effect.get("at_s", 0.0), effect["effect_s"])
    return float(begins_s + effect.get("for_s", math.inf))


def _again_s(trial: Any) -> float:
    """When what a pause interrupted was begun again from an earlier state on: what came before is not measured."""
    names, times_s = [name for name, _ in trial.states], [t_s for _, t_s in trial.states]
    again = (
        times_s[place + 2]
        for place in range(len(names) - 2)
        if names[place] == "PAUSED"
        and times_s[place + 1] == times_s[place + 2]
        and names[place + 2] in names[:place]
    )
    return max(again, default=0.0)


def _spans(trial: Any) -> Iterator[tuple[str, float, float]]:
    ends = [since_s for _, since_s in trial.states[1:]] + [trial.end_s or math.inf]
    for (state, since_s), until_s in zip(trial.states, ends, strict=True):
        yield state, since_s, until_s


def _events(story: Any) -> Iterator[Violation]:
    """Times of events are finite, not after the trial's end, and each state is entered from the one before."""
    last: dict[int, str] = {}
    ends = {trial.number: trial for trial in story.trials}
    for event in story.events():
        number = event.get("trial")
        if (
            not isinstance(event.get("t_s"), int | float)
            or not math.isfinite(event["t_s"])
            or event["t_s"] < -1e-9
        ):
            yield Violation("DATA", "events", number, None, "", f"time of {event}"[:200])
        before, after = event.get("state"), event.get("next")
        if before is not None and number in last and before != last[number]:
            yield Violation(
                "DATA", "events", number, event["t_s"], before, f"in {before}, entered was {last[number]}"
            )
        if after is not None:
            last[number] = after
        trial = ends.get(number)
        if trial is not None and trial.samples and event["t_s"] > trial.samples[-1][0] + 3.0:
            yield Violation(
                "DATA", "events", number, event["t_s"], str(before), "an event after the trial's end"
            )


class Recorded:
    """A recording, read by the mcap and protobuf libraries themselves, with the descriptions in the file alone.

    Attributes:
        blocks: By trial and stream: number of the first sample, how many, times of the first and the last one, and the
            device's own time of the first, in seconds of the trial, in the order of the file.
        skipped: By trial and stream: spans in which nobody asked for it.
        back: What goes back in time.

    Args:
        cut: Whether it may end anywhere.
    """

    def __init__(self, path: Path, cut: bool = False) -> None:
        self.blocks: dict[tuple[int, str], list[tuple[int, int, float, float, float | None]]] = {}
        self.skipped: dict[tuple[int, str], list[tuple[float, float]]] = {}
        self.back = ""
        trial, topics, made = -1, dict[int, Any](), dict[int, Any]()
        last: dict[int, int] = {}
        with path.open("rb") as file:
            records: Iterator[Any] = StreamReader(file, validate_crcs=True).records
            for record in _until_cut(records) if cut else records:
                kind = type(record).__name__
                if kind == "Metadata" and record.name == "trial":
                    trial = int(record.metadata["trial"])
                    last.clear()
                elif kind == "Schema":
                    made[record.id] = _message_class(record)
                elif kind == "Channel":
                    topics[record.id] = record
                elif kind == "Message":
                    channel = topics[record.channel_id]
                    if channel.topic.startswith("/raw/") or channel.topic == "/skipped":
                        self._add(trial, channel, made[channel.schema_id].FromString(record.data))
                    if channel.topic.startswith("/raw/") and record.log_time < last.get(channel.id, 0):
                        self.back = f"{channel.topic} goes back to {record.log_time} ns"
                    last[channel.id] = record.log_time

    def _add(self, trial: int, channel: Any, message: Any) -> None:
        if channel.topic == "/skipped":
            self.skipped.setdefault((trial, message.stream), []).append((message.t0_s, message.t1_s))
            return
        count = len(message.values) // (int(message.dtype[2:]) * message.channels)
        last_s = message.times_s[-1] if message.times_s else message.t0_s + (count - 1) / message.rate_hz
        own_s = message.device_t0_s if message.HasField("device_t0_s") else None
        block = message.seq, count, message.t0_s, last_s, own_s
        self.blocks.setdefault((trial, channel.metadata["stream"]), []).append(block)

    def missing(self, trial: int, stream: str) -> int:
        """Samples between two blocks that did not come, though somebody asked for them."""
        missing, spans = 0, self.skipped.get((trial, stream), ())
        for (seq, count, _, last_s, _), (following, _, first_s, _, _) in pairwise(self.blocks[trial, stream]):
            if not any(t0_s <= first_s and t1_s >= last_s for t0_s, t1_s in spans):
                missing += following - seq - count
        return missing


def _until_cut(records: Iterator[Any]) -> Iterator[Any]:
    with suppress(EndOfFile):
        yield from records


def _message_class(schema: Any) -> Any:
    files = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
    if schema.name not in MESSAGES:
        pool = descriptor_pool.DescriptorPool()
        for file in files.file:
            pool.Add(file)
        MESSAGES[schema.name] = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    return MESSAGES[schema.name]


MESSAGES: dict[str, Any] = {}
"""Classes of the messages that a recording describes, by their names."""


def _recorded(story: Any) -> Iterator[Violation]:
    """The recording is whole and forward in time; what is missing in it is said, and was injected; a bench's own times
    are those of its samples."""
    said, missing = story.manifest["loss"], dict[str, int]()
    for path in sorted(Path(story.folder).glob("*.mcap")):
        try:
            recorded = Recorded(path, cut=_full(story))
        except (McapError, OSError, ValueError, KeyError) as error:
            what = f"{path.name}: {type(error).__name__}: {error}"
            yield Violation("DATA", "readable", *_where(story), what)
            continue
        if recorded.back:
            yield Violation("DATA", "readable", *_where(story), recorded.back)
        for trial, stream in recorded.blocks:
            device = stream.partition(".")[0]
            missing[stream] = missing.get(stream, 0) + recorded.missing(trial, stream)
            if story.manifest["devices"].get(device, {}).get("clock") == "bench":
                for _, _, first_s, _, own_s in recorded.blocks[trial, stream]:
                    if own_s is not None and abs(first_s - own_s) > SAME_TIME_S:
                        what = f"{stream} is stamped {first_s:.9f} s and was taken at {own_s:.9f} s"
                        yield Violation("DATA", "clock", trial, first_s, "", what)
                        break
    gone = {effect["device"] for effect in story.effects if effect["kind"] == "unplug"}
    sent = story.manifest["devices"].keys() - gone  # a signal is missing where its source is
    missing = {stream: count for stream, count in missing.items() if stream.partition(".")[0] in sent}
    for stream, count in missing.items():
        if count > said.get(stream, 0):
            what = f"{count} samples of {stream} are missing, {said.get(stream, 0)} are said to be lost"
            yield Violation("DATA", "lost", *_where(story), what)
    wrong = {effect["device"] for effect in story.effects}
    for stream, count in said.items():
        if stream.partition(".")[0] not in wrong and "loop" not in wrong:
            what = f"{count} samples of {stream} are said to be lost, and nothing was wrong with it"
            yield Violation("DATA", "lost", *_where(story), what)


def _left(story: Any) -> Iterator[Violation]:
    """Threads and file descriptors go with the run."""
    for name, count in story.left.items():
        yield Violation("LIVENESS", "left", *_where(story), f"{count} {name} are left behind")


# --- safety ----------------------------------------------------------------------------------------


def _beyond_reach(story: Any, trial: Any, device: str = "mover", from_s: float = 0.0) -> float:
    """From when on nobody reaches the mover: its line is cut, or it answers late, or the loop is; infinite where that
    never is. What was over `OVER_S` before `from_s`, or a turn that was late once before it, does not count."""
    mover = story.profile["behavior"].get(device)
    kinds = ("silent", "unplug", "lose", "corrupt", "late", "refuse", "double")
    times = [
        effect["effect_s"]
        for effect in story.effects
        if effect["trial"] == trial.number and effect["device"] == mover and effect["kind"] in kinds
        if "every_s" in effect or _ends_s(effect, trial) + OVER_S >= from_s
    ]
    times += [
        effect["effect_s"]
        for effect in story.effects
        if effect["trial"] == trial.number and effect["device"] == "loop"
        if "every_s" in effect or effect["effect_s"] >= from_s
    ]
    return min(times, default=math.inf)


def _still(story: Any) -> Iterator[Violation]:
    """Nothing moves after the last trial's end, unless the line says so."""
    for trial in story.trials:
        for place, speed_m_s in trial.moving.items():
            if abs(speed_m_s) > STILL_M_S and "NOT seen standing still" not in story.line:
                what = f"{place} moves at {speed_m_s * 1e3:.3f} mm/s after the end"
                yield Violation("SAFETY", "still", trial.number, trial.end_s, state_at(trial, None), what)


def _range(story: Any) -> Iterator[Violation]:
    """The first mover's axis stays within the travel of [limits]."""
    least_m = story.limits["travel_min_m"] - OVER_M
    most_m = story.limits["travel_m"] + OVER_M
    for trial in story.trials:
        unreached_s = _beyond_reach(story, trial)
        for t_s, places in trial.samples:
            axis_m = places.get("axis_m", 0.0)
            if not least_m <= axis_m <= most_m and t_s < unreached_s and not _lied(story, trial, t_s):
                what = f"the axis is at {axis_m:.6f} m, outside {least_m:g} .. {most_m:g}"
                yield Violation("SAFETY", "range", trial.number, t_s, state_at(trial, t_s), what)
                break


def _lied(story: Any, trial: Any, t_s: float) -> bool:
    """Whether a sensor that nothing else can judge read something else than there was."""
    return any(
        effect["trial"] == trial.number
        and effect["kind"] in ("wrong", "drift", "stuck", "late", "full_scale")
        and effect["effect_s"] <= t_s
        for effect in story.effects
    )


def _ended_s(story: Any, number: int) -> float | None:
    """When the trial was ended by the guard or a failure."""
    for event in story.events():
        if event.get("trial") == number and event.get("event") in ENDING:
            return float(event["t_s"])
    return None


def _soon(story: Any) -> Iterator[Violation]:
    """A trial that the guard or a failure ended is over within the time that a way out may take."""
    heeded = dict[int, bool]()
    for event in story.events():
        if event.get("event") in ENDING:
            leads = event["next"] != event["state"] or bool(event.get("commands"))
            heeded.setdefault(event["trial"], leads)
    for trial in story.trials:
        ended_s = _ended_s(story, trial.number)
        most_s = WAY_OUT_S if heeded.get(trial.number) else AT_ONCE_S
        if ended_s is not None and trial.samples and trial.samples[-1][0] > ended_s + most_s:
            over_s = trial.samples[-1][0]
            if not any(effect["device"] in ("loop", "keys") for effect in story.effects):
                what = f"it was ended at {ended_s:.3f} s and was over at {over_s:.3f} s"
                yield Violation("LIVENESS", "soon", trial.number, over_s, state_at(trial, over_s), what)


def _pauses(story: Any) -> Iterator[Violation]:
    """In a pause the axis stands."""
    for trial in story.trials:
        if _beyond_reach(story, trial) < math.inf:
            continue
        paused_s = at_m = None
        named = [(since_s, name) for name, since_s in trial.states]
        for t_s, places in trial.samples:
            now = [name for since_s, name in named if since_s <= t_s]
            if not now or now[-1] != "PAUSED" or "axis_m" not in places:
                paused_s = None
            elif paused_s is None or t_s < paused_s + BRAKING_S:
                paused_s, at_m = t_s if paused_s is None else paused_s, places["axis_m"]
            elif at_m is not None and abs(places["axis_m"] - at_m) > 1e-5:
                what = f"the axis moves in a pause, from {at_m:.6f} m to {places['axis_m']:.6f} m"
                yield Violation("SAFETY", "pauses", trial.number, t_s, "PAUSED", what)
                break


def _outdated(story: Any) -> Iterator[Violation]:
    """No answer to an older command leads on."""
    newest: dict[tuple[Any, str], int] = {}
    for event in story.events():
        key = event.get("trial"), event.get("device", "")
        if event.get("event") == "Sent" and MOVES.match(event["command"]):
            newest[key] = max(newest.get(key, 0), event["command_id"])
        leads = event.get("event") in ("Reached", "Standstill") and event["next"] != event["state"]
        if leads and 0 < event["command_id"] < newest.get(key, 0):
            what = f"{event['event']} of command {event['command_id']} leads on, {newest[key]} was sent"
            yield Violation("SAFETY", "outdated", event["trial"], event["t_s"], event["state"], what)
            return


def _late(story: Any) -> Iterator[Violation]:
    """A loop that comes too late while the axis moves is stopped."""
    most_s, turn_s = 1.5 * story.limits["late_s"], 1.0 / story.profile["loop"]["rate_hz"]
    outcomes = {int(row["trial"]): row["outcome"] for row in story.rows}
    mover = story.profile["behavior"].get("mover")
    rested = [
        (event["trial"], event["t_s"])
        for event in story.events()
        if event.get("device") == mover and event["event"] in ("Standstill", "Reached")
    ]
    for effect in story.effects:
        if effect["kind"] != "hang" or effect.get("amount", 0.2) < most_s:
            continue
        for trial in story.trials:
            if trial.number != effect["trial"] or (_full(story) and trial.number not in outcomes):
                continue  # how it ended may not be written any more
            before = [each for each in trial.samples if each[0] <= effect["effect_s"] + 1e-9][-2:]
            after = [each for each in trial.samples if each[0] >= effect["effect_s"] + most_s][:2]
            seen = [(t_s, each["axis_m"]) for t_s, each in (*before, *after) if "axis_m" in each]
            # it went on its way meanwhile, and still does; turns that were taken as one say nothing
            moving = len(seen) == 4 and seen[3][0] - seen[2][0] < 3.0 * turn_s
            steps_m = [two[1] - one[1] for one, two in (seen[1:3], seen[2:])] if moving else [0.0]
            # another way that began since, once it had stood still, is no motion that went on
            moving = moving and (min(steps_m) > 1e-6 or max(steps_m) < -1e-6)
            moving = moving and not any(
                number == trial.number and seen[1][0] <= t_s <= seen[2][0] for number, t_s in rested
            )
            moving = moving and effect["effect_s"] - seen[1][0] < 3.0 * turn_s
            if moving and outcomes.get(trial.number) not in ("guard", "fault", "aborted"):
                what = f"a turn was {effect.get('amount', 0.2):g} s late; the outcome is {outcomes.get(trial.number)}"
                yield Violation("SAFETY", "late", trial.number, effect["effect_s"], "", what)


def _at_once(story: Any) -> Iterator[Violation]:
    """In the turn in which the guard, a failure or a person ends a trial its mover is told to stop, whatever follows;
    or was told so before, or sent back by the guard, and nothing else since."""
    mover, turn_s = story.profile["behavior"].get("mover"), 1.0 / story.profile["loop"]["rate_hz"]
    told: dict[int, list[tuple[float, bool]]] = {}
    last_s: dict[int, float] = {}
    back: Sequence[str] = ()
    for event in story.events():
        last_s[event.get("trial", 0)] = event["t_s"]
        if event.get("event") == "Retreated" and event["device"] == mover:
            back = event["commands"]
        elif event.get("event") == "Sent" and event["device"] == mover and MOVES.match(event["command"]):
            ends = event["command"].startswith("Stop(") or event["command"] in back
            told.setdefault(event["trial"], []).append((event["t_s"], ends))
    trials, full = {trial.number: trial for trial in story.trials}, _full(story)
    pressed = [
        {"event": "abort", "t_s": effect["effect_s"], "trial": effect["trial"], "state": ""}
        for effect in story.effects
        if effect["kind"] == "abort"
    ]
    for event in (*story.events(), *pressed):
        trial = trials.get(event.get("trial", 0))
        if trial is None or event.get("event") not in ("GuardStopped", "Failed", "abort") or not mover:
            continue
        if full and event["t_s"] > last_s[trial.number] - 2.0 * turn_s:
            continue  # what was sent is told a turn later, and may not be written any more
        if "sticks" in event.get("reason", ""):  # since its last sample, which came before the turn
            continue
        if (
            event["state"] in ("DONE", "FAILED")
            or _beyond_reach(story, trial, from_s=event["t_s"]) < math.inf
        ):
            continue
        # a device that failed says when, between two turns; that it is silent the loop says, of its own turn
        later_s = [t_s for t_s, _ in trial.samples if t_s > event["t_s"] - 1e-6]
        between = event["event"] != "GuardStopped" and " is silent " not in event.get("reason", "")
        turns_s = [event["t_s"], *later_s[: 2 if between else 1]]
        kept_s = _kept_back_s(story, trial, event["t_s"])
        # what a turn asked for and a late line keeps back is in hand in the first turn after
        due_s = turns_s[-1] + kept_s
        end_s = min((t_s for t_s in later_s if t_s > due_s - 1e-6), default=due_s) + 0.5 * turn_s
        commands = told.get(trial.number, ())
        stopped = any(
            stop
            and (
                any(abs(sent_s - t_s) < 0.5 * turn_s for t_s in turns_s)
                or (kept_s > 0.0 and event["t_s"] - kept_s < sent_s < end_s)
            )
            for sent_s, stop in commands
        )
        before = [stop for sent_s, stop in commands if sent_s < end_s]
        if not stopped and not (before and before[-1]):
            what = f"{event['event']} at {event['t_s']:.4f} s, and {mover} was not told to stop then"
            yield Violation("SAFETY", "at once", trial.number, event["t_s"], event["state"], what)


def _kept_back_s(story: Any, trial: Any, t_s: float) -> float:
    """By how much a turn may be kept back by devices that answer late just then."""
    most_s = 0.0
    for effect in story.effects:
        if effect["kind"] == "late" and effect["trial"] == trial.number:
            late_s = effect.get("amount", LATE_S)
            ends_s = math.inf if "every_s" in effect else _ends_s(effect, trial)
            if effect["effect_s"] - late_s <= t_s <= ends_s + late_s:
                most_s = max(most_s, late_s)
    return most_s


def _unseen(story: Any) -> Iterator[Violation]:
    """Where a mover cannot be asked any more at the end, the line says that nobody saw it standing still; and where
    nothing was wrong with it, the line does not."""
    mover = story.profile["behavior"].get("mover")
    wrong = {effect["device"] for effect in story.effects if effect["kind"] != "slow"}
    if mover and f"NOT seen standing still: {mover}" in story.line and not wrong & {mover, "loop", "disk"}:
        yield Violation(
            "SAFETY", "unseen", *_where(story), f"nothing was wrong with {mover}; it says: {story.line}"
        )
    for effect in story.effects:
        gone = effect["kind"] in ("silent", "unplug") and "for_s" not in effect and effect["device"] == mover
        last = story.trials[-1].number == effect["trial"] if story.trials else False
        if (
            gone
            and last
            and not _stood(story, effect["trial"], mover, effect["effect_s"])
            and "NOT seen standing still" not in story.line
        ):
            what = f"{mover} is {effect['kind']}; it says: {story.line}"
            yield Violation("SAFETY", "unseen", effect["trial"], effect["effect_s"], "", what)


def _stood(story: Any, number: int, mover: str, t_s: float) -> bool:
    """Whether a mover had answered its last command by then, however late that was heard."""
    seen = [event for event in story.events() if event["trial"] == number and event.get("device") == mover]
    asked = [each for each in seen if each["event"] == "Sent" and MOVES.match(each["command"])]
    answers = [each for each in seen if each["event"] == "Standstill" and each["t_s"] <= t_s]
    return any(each["command_id"] == asked[-1]["command_id"] for each in answers) if asked else False


def _stops(story: Any) -> Iterator[Violation]:
    """After a stop or a failure nothing goes further in: the axis not forward, the jaws not together."""
    for trial in story.trials:
        ended_s = _ended_s(story, trial.number)
        if ended_s is None:
            continue
        for place, device, sign in (("axis_m", "mover", 1.0), ("width_m", "gripper", -1.0)):
            if _beyond_reach(story, trial, device, ended_s) < math.inf:
                continue
            farthest = -math.inf
            for t_s, places in trial.samples:
                if place not in places or t_s <= ended_s:
                    continue
                at_m = sign * places[place]
                beyond_m = farthest + (1e-5 if device == "mover" else 2e-4)
                if t_s > ended_s + BRAKING_S and -math.inf < beyond_m < at_m:
                    what = (
                        f"{place} went on to {sign * at_m:.6f} m from {sign * farthest:.6f} m after the stop"
                    )
                    yield Violation("SAFETY", "stops", trial.number, t_s, state_at(trial, t_s), what)
                    break
                farthest = max(farthest, at_m)


def _force(story: Any) -> Iterator[Violation]:
    """Once the true force is beyond its limit, the axis goes no further in than the guard's filter, a few turns and
    braking take: what that adds to the force is the forecast."""
    limit_n, mover = story.limits.get("force_n"), story.profile["behavior"].get("mover")
    if limit_n is None:
        return
    turn_s = 1.0 / story.profile["loop"]["rate_hz"]
    deaf = str(story.limits["force_stream"]).partition(".")[0]
    for trial in story.trials:
        pressed = [
            (t_s, places["axis_m"], abs(places["force_n"]))
            for t_s, places in trial.samples
            if "axis_m" in places and "force_n" in places
        ]
        if not pressed or pressed[0][2] > limit_n or _of_loop(story, trial):
            continue
        wrong = [
            effect["effect_s"]
            for effect in story.effects
            if effect["trial"] == trial.number and effect["device"] in (deaf, mover)
        ]
        over = _held_over(
            pressed, OVER_SHARE * limit_n, 2.0 * story.limits["force_median_s"] + 3.0 * turn_s, 3.0 * turn_s
        )
        if over is None or min(wrong, default=math.inf) <= pressed[-1][0]:
            continue
        over_s, over_m, over_n = pressed[over]
        before_s, before_m, _ = pressed[max(0, over - 1)]
        speed_m_s = max(0.0, (over_m - before_m) / max(over_s - before_s, 1e-9))
        # by now the guard has seen it; a turn or two, and braking as an arm does, with 0.5 m/s2
        most_m = speed_m_s * (2.0 * turn_s + 0.01) + speed_m_s**2 + 5e-5
        farthest_m = max(axis_m for t_s, axis_m, _ in pressed if t_s >= over_s)
        if farthest_m > over_m + most_m:
            what = (
                f"at {over_n:.3f} N (limits.force_n = {limit_n:g}) and {speed_m_s * 1e3:.2f} mm/s the axis went"
                f" {(farthest_m - over_m) * 1e3:.3f} mm further in, {most_m * 1e3:.3f} mm were to be"
            )
            yield Violation("SAFETY", "force", trial.number, over_s, state_at(trial, over_s), what)


def _held_over(
    pressed: Sequence[tuple[float, float, float]], limit_n: float, span_s: float, near_s: float
) -> int | None:
    """From which sample on the force has been beyond the limit for so long, at every look: a finger rattles. Of looks
    that are farther apart than `near_s`, between which quiet turns were taken together, it takes more."""
    looks, since_s, last_s, far = 0, 0.0, -math.inf, False
    for place, (t_s, _, force_n) in enumerate(pressed):
        if force_n <= limit_n:
            looks = 0
        elif looks == 0:
            looks, since_s, far = 1, t_s, False
        else:
            looks, far = looks + 1, far or t_s - last_s > near_s
            if t_s - since_s > span_s and (looks >= FAR_LOOKS or not far):
                return place
        last_s = t_s
    return None


def _grip(story: Any) -> Iterator[Violation]:
    """The jaws press no harder than they may be asked to."""
    most_n = story.limits["grip_n"] * 1.2 + 2.0
    for trial in story.trials:
        for t_s, places in trial.samples:
            if places.get("grip_n", 0.0) > most_n and state_at(trial, t_s) not in CLOSES_ITSELF:
                what = f"the jaws press with {places['grip_n']:.1f} N, limits.grip_n = {story.limits['grip_n']:g}"
                yield Violation("SAFETY", "grip", trial.number, t_s, state_at(trial, t_s), what)
                break


def _blind(story: Any) -> Iterator[Violation]:
    """No motion goes on while a stream that every motion needs does not come."""
    needed = {
        str(stream).partition(".")[0]
        for key in ("force_stream", "position_stream", "pose_stream")
        if (stream := story.limits.get(key))
        and (key != "force_stream" or story.limits.get("force_n") is not None)
    }
    patient_s = story.limits["stale_s"] + 4.0 / story.profile["loop"]["rate_hz"] + BRAKES_S
    for effect in story.effects:
        if effect["device"] not in needed or effect["kind"] not in CUT or "every_s" in effect:
            continue
        for trial in story.trials:
            if trial.number != effect["trial"] or _of_loop(story, trial):
                continue
            ends_s = _ends_s(effect, trial)
            cut = [
                (t_s, places["axis_m"])
                for t_s, places in trial.samples
                if effect["effect_s"] <= t_s <= ends_s and "axis_m" in places
            ]
            stood_s, way_m, seen_s = effect["effect_s"], 0.0, 0.0
            for (before_s, from_m), (t_s, axis_m) in pairwise(cut):
                if axis_m <= from_m + 1e-9:  # a motion may begin, for its first samples are about to come
                    stood_s = t_s
                elif before_s >= stood_s + patient_s:
                    way_m, seen_s = way_m + axis_m - from_m, t_s
            if way_m > (BLIND_M if _beyond_reach(story, trial) < math.inf else 1e-5):
                what = f"{effect['device']} is {effect['kind']} and the axis went {way_m * 1e3:.3f} mm further in"
                yield Violation("SAFETY", "blind", trial.number, seen_s, state_at(trial, seen_s), what)


def _of_loop(story: Any, trial: Any) -> bool:
    return any(effect["device"] == "loop" and effect["trial"] == trial.number for effect in story.effects)


CHECKERS = (
    *(_exit, _rows, _outcomes, _ended, _touched, _spared, _named, _required, _events, _recorded, _left),
    *(_still, _range, _stops, _force, _grip, _blind),
    *(_soon, _pauses, _outdated, _late, _at_once, _unseen),
)

# --- two stories -----------------------------------------------------------------------------------


def same(one: Any, other: Any, why: str) -> Iterator[Violation]:
    """Two stories that must be equal to the byte."""
    for name, a, b in zip(("trials.csv", "events.jsonl"), one.raw, other.raw, strict=True):
        if a != b:
            yield Violation("NONDETERMINISM", why, *_where(other), f"{name}: {_difference(a, b)}")
            return


def healed(broken: Any, resumed: Any, healthy: Any) -> Iterator[Violation]:
    """A run that broke off and goes on, once nothing goes wrong any more, ends as one that never broke off; trials in
    which something went wrong and that were kept apart."""
    if resumed.error is not None:
        yield Violation(
            "LIVENESS", "resume", *_where(resumed), f"{type(resumed.error).__name__}: {resumed.error}"
        )
        return
    if healthy.exit_code == 4 and _of_drawn(healthy):
        return
    if healthy.exit_code not in (0, 1):
        what = f"nothing goes wrong in it, and it ends with {healthy.exit_code}: {healthy.line}"
        yield Violation("LIVENESS", "healthy", *_where(healthy), what)
        return
    touched = {effect["trial"] for effect in broken.effects}
    again = {trial.number for trial in resumed.trials}
    lines, expected = _lines(resumed.raw[0]), _lines(healthy.raw[0])
    if lines.keys() != expected.keys():
        yield Violation(
            "LIVENESS", "resume", *_where(resumed), f"trials {sorted(lines)}, expected {sorted(expected)}"
        )
    whole = len(resumed.raw[0].splitlines()) - 1
    if whole != len(lines):
        yield Violation("LIVENESS", "resume", *_where(resumed), f"{whole} rows of {len(lines)} trials")
    for number, line in lines.items():
        if number not in again and line.split(",")[1] in ("guard", "fault", "aborted"):
            what = f"trial {number} ended as {line.split(',')[1]}, and was not run again"
            yield Violation("LIVENESS", "resume", int(number), None, "", what)
        if (number in again or int(number) not in touched) and line != expected.get(number):
            what = f"trial {number}: {_difference(line.encode(), expected.get(number, '').encode())}"
            yield Violation("LIVENESS", "untouched", int(number), None, "", what)


def _lines(raw: bytes) -> Mapping[Any, str]:
    return {int(line.partition(",")[0]): line for line in raw.decode().splitlines()[1:]}


def _difference(one: bytes, other: bytes) -> str:
    """Where two texts differ first."""
    for number, (a, b) in enumerate(zip(one.splitlines(), other.splitlines(), strict=False), start=1):
        if a != b:
            place = next(
                (k for k, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b))
            )
            begin = max(0, place - 60)
            return f"line {number}: …{a[begin : place + 40]!r} and …{b[begin : place + 40]!r}"
    return f"{len(one)} bytes and {len(other)}"
