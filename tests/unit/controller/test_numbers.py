"""What a command's numbers may be at the gate."""

import math
from dataclasses import fields
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.limits import GuardRefusal
from controller.numbers import normalised
from drivers.core.messages import (
    Chirp,
    Excite,
    Grip,
    LoadWeight,
    MoveAt,
    MovePose,
    MoveTo,
    Release,
    SetTendon,
    Stop,
    Tone,
    Twist,
)

COMMANDS = (
    MoveAt("stage", 0.01, 0.02),
    MoveTo("stage", 0.01, 0.02),
    Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.1, 0.0), 0.5),
    MovePose("arm", (0.01, 0.0, 0.0, 0.0, 0.1, 0.0), 0.02),
    Grip("gripper", 0.01, 0.02, 10.0),
    Release("gripper", 0.02),
    Tone("audio", 40_000.0, 0.5),
    Chirp("audio", 20_000.0, 40_000.0, 1.0, 0.5),
    SetTendon("board", 0.01),
    LoadWeight("operator", "x", 1.0),
)
PLACES = [
    (command, field.name, slot)
    for command in COMMANDS
    for field in fields(command)
    for slot in (range(6) if isinstance(getattr(command, field.name), tuple) else (None,))
    if isinstance(getattr(command, field.name), float | tuple)
]
REAL = st.floats(-1e6, 1e6, width=32)
KINDS = st.sampled_from([float, np.float16, np.float32, np.float64, np.longdouble])
WHOLE = st.sampled_from([int, np.int8, np.uint8, np.int32, np.int64])
OTHERS = [True, np.True_, None, "0.01", b"1", 1j, Decimal("0.01"), Fraction(1, 3), 10**400, [0.01]]
NO_NUMBERS = st.one_of(
    st.sampled_from([math.nan, math.inf, -math.inf]).flatmap(lambda x: KINDS.map(lambda kind: kind(x))),
    st.sampled_from([*OTHERS, np.array(0.01)]),
)


def with_number(place, number):
    """The command with another number in one place."""
    command, name, slot = place
    values = {field.name: getattr(command, field.name) for field in fields(command) if field.name != "id"}
    if slot is None:
        values[name] = number
    else:
        values[name] = tuple(number if index == slot else old for index, old in enumerate(values[name]))
    return type(command)(**values)


def number_in(command, place):
    value = getattr(command, place[1])
    return value if place[2] is None else value[place[2]]


@given(st.sampled_from(PLACES), REAL, KINDS)
def test_a_real_number_of_any_width_becomes_a_float(place, value, kind):
    with np.errstate(over="ignore"):
        made = kind(value)
    if not np.isfinite(made):
        return
    found = number_in(normalised(with_number(place, made)), place)
    assert type(found) is float
    assert found == float(made)


@given(st.sampled_from(PLACES), st.integers(0, 127), WHOLE)
def test_a_whole_number_becomes_a_float(place, value, kind):
    found = number_in(normalised(with_number(place, kind(value))), place)
    assert type(found) is float
    assert found == value


@given(st.sampled_from(PLACES), NO_NUMBERS)
def test_what_is_no_finite_number_is_refused_with_its_field(place, value):
    command = with_number(place, value)
    with pytest.raises(GuardRefusal, match=rf"^{type(command).__name__}\({command.device}\): {place[1]} is "):
        normalised(command)


ROWS = [(command, name) for command, name, slot in PLACES if slot == 0]


@given(
    st.sampled_from(ROWS),
    st.lists(REAL, max_size=8),
    st.sampled_from([tuple, list, np.array, lambda row: np.array(row, np.float32)]),
)
def test_a_row_of_the_known_length_becomes_a_tuple_of_floats_and_no_other_passes(place, row, kind):
    command = with_number((*place, None), kind(row))
    if len(row) != 6:
        with pytest.raises(GuardRefusal, match="give 6 numbers"):
            normalised(command)
        return
    found = getattr(normalised(command), place[1])
    assert type(found) is tuple
    assert [type(each) for each in found] == [float] * 6
    assert found == tuple(row)


@pytest.mark.parametrize("row", ["123456", {*range(6)}, range(6), np.zeros((6, 1)), np.array(1.0), None])
def test_what_is_no_row_is_refused(row):
    with pytest.raises(GuardRefusal, match=r"offset is"):
        normalised(MovePose("arm", row, 0.02))


@pytest.mark.parametrize("command", [*COMMANDS, Stop("stage"), Excite("board", True)])
def test_what_is_as_declared_passes_as_it_is(command):
    assert normalised(command) is command


@pytest.mark.parametrize("command", [Excite("board", 1), Stop(7), LoadWeight("operator", None, 1.0)])
def test_what_is_of_another_type_than_declared_is_refused(command):
    with pytest.raises(GuardRefusal, match=r"give a (bool|str)"):
        normalised(command)
