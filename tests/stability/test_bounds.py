"""Every number of plants and detectors at both ends of what it may be: refused in one line, or computed with an end."""

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, get_args, get_origin

import numpy as np
import pytest
from pydantic import BaseModel, ValidationError

from controller.registry import KINDS, find
from simulator.physics.aura_drive import AuraDrive
from simulator.physics.aura_settings import EchoSettings
from simulator.physics.finger import FingerPlant, FingerSettings
from simulator.physics.jaws_drive import JawsDrive
from simulator.physics.piecewise import rising
from simulator.physics.slip import SENSORS, SlipPlant
from simulator.physics.stage_axis import StageAxis
from simulator.physics.tool_motion import ToolMotion
from tests.contracts.test_detectors import INPUTS

Path = tuple[str | int, ...]


def ends(kind: Any, rules: Mapping[str, Any], path: Path) -> Iterator[tuple[Path, Any]]:
    """Both ends of each number in what has this type; without a bound, the largest that a float can be."""
    arguments = get_args(kind)
    if get_origin(kind) is Annotated:
        known = {
            key: getattr(rule, key)
            for part in arguments[1:]
            for rule in getattr(part, "metadata", [part])
            for key in ("ge", "gt", "le", "lt")
            if hasattr(rule, key)
        }
        yield from ends(arguments[0], rules | known, path)
    elif kind in (int, float):
        lower = rules.get("ge", -1e308)
        if "gt" in rules:
            lower = math.nextafter(rules["gt"], math.inf)
            yield path, rules["gt"] + 1e-12
        upper = math.nextafter(rules["lt"], -math.inf) if "lt" in rules else rules.get("le", 1e308)
        yield from ((path, kind(value)) for value in (lower, upper))
    elif isinstance(kind, type) and issubclass(kind, BaseModel):
        for name, field in kind.model_fields.items():
            yield from ends(Annotated[field.annotation, *(field.metadata or ["no bound"])], {}, (*path, name))
    elif get_origin(kind) is tuple:
        for place, part in enumerate(part for part in arguments if part is not ...):
            yield from ends(part, {}, (*path, place))
    elif get_origin(kind) is dict:
        yield from ends(arguments[1], {}, (*path, get_args(arguments[0])[0]))
    else:  # a number or None
        for part in arguments:
            yield from ends(part, rules, path)


def put(table: Any, path: Path, value: Any) -> Any:
    """The same table with another value at one place."""
    if not path:
        return value
    if isinstance(path[0], int):
        there = list(table or 2 * (4e4 if isinstance(value, float) else value,))
        return [*there[: path[0]], put(there[path[0]], path[1:], value), *there[path[0] + 1 :]]
    return table | {path[0]: put(table[path[0]], path[1:], value)}


def tool(axis: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> ToolMotion:
    return ToolMotion(axis, acceleration_m_s2=0.5, max_speed_m_s=0.1)


def moved(bench: Any, carrier: ToolMotion, offset: tuple[float, ...], streams: frozenset[str]) -> None:
    """Goes to a place and rests there for 50 ms, read all the way."""
    carrier.move_pose(bench.t_s, offset, 0.1)
    bench.on_plan(bench.t_s)
    until_s = carrier.arrival_s + 0.05
    while bench.t_s < until_s:
        bench.advance(bench.t_s + 0.05, streams)


def finger(bench: Any, settings: Any) -> Iterator[Any]:
    """Excited, bent, met, pressed for 50 ms; left for 5 s that nobody reads; then a trial that begins in contact."""
    carrier = tool()
    bench.mount(carrier)
    streams = [spec.name for spec in bench.streams() if spec.rate_hz]
    read = frozenset(streams) | {"period"}
    yield 0.0
    bench.excite(True)
    bench.set_tendon(1e-3)
    bench.advance(0.05, read)
    surface_m = settings.surface_m
    for place_m, wait_s, channels in ((surface_m + 1e-4, 0.05, read), (0.0, 5.2, frozenset[str]())):
        carrier.move_to(bench.t_s, place_m, 0.1)
        bench.on_plan(bench.t_s)
        bench.advance(carrier.arrival_s, channels)
        bench.advance(carrier.arrival_s + wait_s, channels)
        bench.advance(bench.t_s + 0.05, read)
        yield bench.force_n
        yield from bench.events("period")
        yield from (bench.sample(stream, np.array([bench.t_s])) for stream in streams)
    carrier.place(bench.t_s, surface_m + 1e-4)
    bench.begin(bench.t_s, 5, 2, {}, settings.model_dump(mode="json"))
    bench.advance(bench.t_s + 0.05, read)
    yield bench.force_n


def slip(bench: Any, settings: Any) -> Iterator[Any]:
    """Pressed by 0.5 mm, rolled, slid by 5 mm; everything that senses is read."""
    carrier = tool((0.0, 0.0, -1.0))
    bench.mount(carrier)
    yield 0.0
    down_m = -settings.surface_m - 5e-4
    for offset in ((0.0, 0.0, down_m), (0.0, 0.0, down_m, 0.0, 0.3, 0.0), (0.005, 0.0, down_m)):
        moved(bench, carrier, (*offset, 0.0, 0.0, 0.0)[:6], frozenset({"fingertip", "flexible"}))
        now_s = np.array([bench.t_s])
        yield from (bench.sample(stream, now_s) for stream in ("fingertip", "flexible"))
        yield bench.wrench(now_s, (0.0, 0.0, -1.0))
        yield bench.forces_n(11, now_s)
        yield bench.texels_v(now_s)


def aura(bench: Any, _: Any) -> Iterator[Any]:
    """Driven, moved, closed on what is there."""
    carrier = tool()
    bench.mount(carrier)
    yield 0.0
    bench.drive(40_000.0, 0.5)
    bench.jaws.calibrate()
    bench.advance(8.0)
    bench.jaws.go(1.0, 40_000.0, 300.0)
    bench.advance(9.0)
    moved(bench, carrier, (0.01, 0.0, 0.01, 0.0, 0.0, 0.0), frozenset({"pad"}))
    now_s = np.floor(bench.t_s * 1000.0) / 1000.0 - np.arange(0.02, 0.0, -0.001)
    yield from (bench.baseband(now_s), bench.wrench(now_s, (1.0, 0.0, 0.0)))
    yield bench.carrier(int(now_s[0] * 96_000), 100)
    if hasattr(bench, "sample"):
        yield bench.sample("pad", now_s[-1:])


Trial = Callable[[Any, Any], Iterator[Any]]
TRIALS: Mapping[str, Trial] = {"finger": finger, "slip": slip, "aura": aura, "grasp": aura}
ENDS = {kind: list(ends(find("plant", kind).settings, {}, ())) for kind in KINDS["plant"]}
ENDS["grasp"] = [case for case in ENDS["grasp"] if case not in ENDS["aura"]]
"""A grasp's bench is aura's with a pad."""

CASES = [(kind, *case) for kind, cases in ENDS.items() for case in cases]


def plant_of(kind: str, path: Path, value: Any) -> Any:
    settings_class = find("plant", kind).settings
    table = settings_class().model_dump(mode="json")
    if "room" in table:
        table["room"]["echoes"] = [EchoSettings(size_fs=0.1).model_dump(mode="json")]
    return settings_class.model_validate_json(json.dumps(put(table, path, value)))


@pytest.mark.parametrize(("kind", "path", "value"), CASES)
def test_a_number_at_its_bound_is_refused_or_computed(kind, path, value):
    try:
        settings = plant_of(kind, path, value)
    except ValidationError as refused:
        (error,) = refused.errors()
        said = {"noise_scale", "cost"} & set(error["msg"].split())
        assert said, "within its bounds: what it would do is said"
        return
    bench = find("plant", kind).made(settings)
    results = TRIALS[kind](bench, settings)
    next(results)  # carries the tool
    bench.begin(0.0, 5, 1, {}, settings.model_dump(mode="json"))
    for result in results:
        assert np.isfinite(result).all()


DETECTOR_CASES = [
    (kind, *case)
    for kind in KINDS["detector"]
    for case in ends(find("detector", kind).settings, {}, ())
    if case[0] != ("channels", 0)  # whole numbers beyond a machine's
]


@pytest.mark.parametrize(("kind", "path", "value"), DETECTOR_CASES)
def test_a_detectors_number_at_its_bound_is_refused_or_computed(kind, path, value):
    detector_class, settings_class, _ = find("detector", kind)
    table = put(settings_class().model_dump(mode="json"), path, value)
    try:
        detector = detector_class("name", settings_class.model_validate_json(json.dumps(table)))
        events = [event for block in INPUTS[kind]() for event in detector.push(block)]
    except ValueError as refused:  # what the stream decides: too few samples a window, no such channel
        assert re.search("longer|positive|share|no channel", str(refused))
        return
    assert all(math.isfinite(event.t_s) for event in events)


MOVERS: Mapping[str, Callable[[float], Any]] = {
    "probe": lambda far: FingerPlant(FingerSettings()).move_probe([(0.0, 0.0, 0.0, far)]),
    "stage to": lambda far: StageAxis(acceleration_m_s2=0.5, max_speed_m_s=0.1).move_to(0.0, far, 0.1),
    "stage at": lambda far: StageAxis(acceleration_m_s2=0.5, max_speed_m_s=0.1).move_at(0.0, 0.1, far),
    "tool to": lambda far: tool().move_to(0.0, far, 0.1),
    "tool at": lambda far: tool().move_at(0.0, 0.1, far),
    "tool's pose": lambda far: tool().move_pose(0.0, (0.0, far, 0.0, 0.0, 0.0, 0.0), 0.1),
    "tool's twist": lambda far: tool().twist(0.0, (0.0, far, 0.0, 0.0, 0.0, 0.0), 0.1),
    "jaws": lambda far: JawsDrive(0.008).go(far, 40_000.0, 300.0),
    "drive": lambda far: AuraDrive().tone(0.0, far, 0.5),
    "sweep": lambda far: AuraDrive().sweep(0.0, 39e3, far, 1.0, 0.5),
    "tip": lambda far: SlipPlant(SENSORS["fingertip"]).advance(*np.full((3, 1), far)),
}


@pytest.mark.parametrize("far", [1e308, -1e308, math.inf, math.nan])
@pytest.mark.parametrize("mover", MOVERS)
def test_an_absurd_course_is_refused(mover, far):
    with pytest.raises(ValueError, match=r"1e\+06"):
        MOVERS[mover](far)


def test_what_is_not_finite_has_no_crossing_and_the_search_ends():
    assert rising(np.array([math.nan] * 4), 3, 2, 1.0, 0.0) == math.inf
