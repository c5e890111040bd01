"""What a campaign will take, move and press, estimated before anything is opened."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

if TYPE_CHECKING:
    from config.profile import Profile
    from config.trials import Trial
    from controller.campaign import CampaignPlan, TrialPlan

COSTS = Path(__file__).with_name("costs.toml")
"""What a trial of each shipped profile took: `python -m benchmarks.costs`."""

_UNITS = ((48 * 3600.0, 86400.0, "days"), (3600.0, 3600.0, "h"), (60.0, 60.0, "min"), (1.0, 1.0, "s"))
_SIZES = ((1e9, 1e9, "GB"), (1e6, 1e6, "MB"), (1e3, 1e3, "kB"))
"""From how much a unit is used, its size, and its name."""


class Cost(NamedTuple):
    """What some trials take: bench time, computing on one core of a mock bench (s), and disk (bytes)."""

    bench_s: float
    computing_s: float
    disk_bytes: float


def cost(profile: str, experiment: str, trials: int) -> Cost | None:
    """What trials of a profile take, by what it, or else its experiment, took when it was measured; None if unknown."""
    measured = _own(profile) or next(
        (row for row in _table().values() if row["experiment"] == experiment), None
    )
    if measured is None:
        return None
    return Cost(*(trials * float(measured[name]) for name in Cost._fields))


def _own(profile: str) -> dict[str, Any] | None:
    """What was measured of a profile, or of its mock twin."""
    same = profile.replace("emulated/", "mock/").replace("hardware/", "mock/")
    return _table().get(profile) or _table().get(same)


def planned(profile: Profile, trials: Sequence[Trial], campaign: CampaignPlan, workers: int) -> Iterator[str]:
    """What `run` would do, a line each.

    Args:
        campaign: Those of different factors (`config.trials.distinct`), ready to run.
        workers: In how many processes they would run.
    """
    yield f"{profile.name}: {counted(len(trials))} of {profile.experiment} on the {profile.bench} bench"
    yield f"time      {duration(profile.name, profile.experiment, profile.bench, len(trials), workers)}"
    found = cost(profile.name, profile.experiment, len(trials))
    yield f"disk      {_rounded(found.disk_bytes, _SIZES) if found else 'not measured'}"
    yield f"opens     {', '.join(sorted(campaign.devices))}"
    limits: Any = profile.limits
    asked = [(profile.for_trial(trial).behavior, profile.factors_of(trial)) for trial in trials]
    speeds = (_speeds(settings.model_dump()) for pair in asked for settings in pair)
    speed_m_s = max(chain.from_iterable(speeds), default=0.0)
    travel = f"{limits.travel_min_m:g} to {limits.travel_m:g} m of travel"
    speed = f"at {speed_m_s:g} m/s" if speed_m_s else "no speed is set in m/s"
    yield f"motion    {travel}, {speed}; the guard stops beyond {limits.speed_m_s:g} m/s"
    yield f"force     {_force(profile, speed_m_s)}"
    yield from _subscriptions(profile, trials, campaign.trials)


def _subscriptions(profile: Profile, trials: Sequence[Trial], plans: Iterable[TrialPlan]) -> Iterator[str]:
    """What each state subscribes to; trials that do alike together."""
    from config.trials import alike  # `list` has no trial, and loads nothing that validates one

    repeated = {same[0].id: [trial.id for trial in same] for same in alike(trials)}
    groups: dict[str, list[int]] = {}
    armed: set[str] = set()
    for trial in plans:
        armed |= {
            name for each in trial.behavior.foreseen.values() for plan in each for name in plan.detectors
        }
        groups.setdefault("\n".join(_states(trial)), []).extend(repeated[trial.trial])
    for lines, numbers in groups.items():
        if len(groups) > 1:
            yield f"trials    {_ranges(sorted(numbers))}"
        yield lines
    idle = sorted(set(profile.detectors) - armed)
    if idle:
        yield f"never     {', '.join(idle)}: no state subscribes"


def _states(trial: TrialPlan) -> Iterator[str]:
    """States that subscribe to the same, and to what."""
    behavior = trial.behavior
    guarded = sorted(trial.guard.inputs | behavior.range_streams)
    if guarded:
        yield f"guard     {', '.join(guarded)}: in every motion, and wherever a state subscribes"
    together: dict[str, dict[str, None]] = {}
    for state in behavior.states:
        for plan in behavior.foreseen.get(state, ()):
            names = [f"{name} ({', '.join(trial.detectors[name].inputs)})" for name in sorted(plan.detectors)]
            names += [f"{name} (recorded)" for name in sorted(plan.measures)]
            together.setdefault(", ".join(names) or "skipped: no subscriber", {})[state] = None
    for subscribed, states in together.items():
        yield f"{', '.join(states)}\n          {subscribed}"


def _ranges(numbers: Sequence[int]) -> str:
    """`1-3, 7` of ascending numbers."""
    begins = [number for number in numbers if number - 1 not in numbers]
    ends = [number for number in numbers if number + 1 not in numbers]
    return ", ".join(
        f"{begin}-{end}" if end > begin else f"{begin}" for begin, end in zip(begins, ends, strict=True)
    )


def counted(trials: int) -> str:
    """`1 trial`, `3 trials`."""
    return f"{trials} trial{'s' * (trials != 1)}"


def duration(name: str, experiment: str, bench: str, trials: int, workers: int = 1) -> str:
    """How long trials take, as text."""
    found = cost(name, experiment, trials)
    if found is None:
        return "not measured"
    bench_time, other = _rounded(found.bench_s, _UNITS), "" if _own(name) else ", as shipped with its devices"
    if bench != "mock":
        return f"about {bench_time}{other}"
    cores = f" on {workers} cores" if workers > 1 else ""
    computing = _rounded(found.computing_s / workers, _UNITS)
    return f"about {bench_time} of bench time, computed in {computing}{cores}{other}"


def _speeds(settings: Any) -> Iterator[float]:
    """All speeds in settings, however deep, m/s: names end in their unit."""
    from controller.scales import si_unit  # `list` plans nothing, and loads nothing that it does not need

    if isinstance(settings, Mapping):
        yield from (abs(value) for key, value in settings.items() if si_unit(key) == "m/s" and value)
        settings = settings.values()
    if isinstance(settings, Iterable) and not isinstance(settings, str):
        for each in settings:
            yield from _speeds(each)


def _force(profile: Profile, speed_m_s: float) -> str:
    from config.assemble import limits_of  # `list` has no bench, and loads nothing that makes one
    from controller.forecast import forecast, refusal

    limits, loop = limits_of(profile), cast("Any", profile.loop)
    if limits.force_n is None:
        return "no limit (limits.force_n is not set)"
    stop, turn_s = f"the guard stops at {limits.force_n:g} N", 1.0 / loop.rate_hz
    if not speed_m_s:
        return f"{stop}; no speed is set in m/s, so no peak is forecast"
    found = forecast(limits, speed_m_s, turn_s)
    if found is None:
        return f"{stop}; no contact stiffness is known (limits.stiffness_n_m), so no peak is forecast"
    ended = "" if found.peak_n is None else f"{found.peak_n:.2g} N where the detector ends it, "
    latency_ms = 1e3 * (limits.force_median_s + turn_s)
    line = (
        f"{stop}; {ended}{found.most_n:.2g} N at the most if it alone does, with {speed_m_s:g} m/s"
        f" x {latency_ms:.0f} ms (median and a turn), {limits.braking_m_s2:g} m/s2 and {limits.stiffness_n_m:g} N/m"
    )
    refused = refusal(limits, speed_m_s, turn_s)
    return f"{line}; it will be refused: {refused}" if refused else line


@cache
def _table() -> dict[str, dict[str, Any]]:
    return tomllib.loads(COSTS.read_text("utf-8"))


def _rounded(value: float, units: Sequence[tuple[float, float, str]]) -> str:
    _, size, unit = next((each for each in units if value >= each[0]), units[-1])
    return f"{float(f'{value / size:.2g}'):g} {unit}"
