from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from controller.recording.schemas import decode_block, encode_block, log_schema, sample_schema, schema_of
from drivers.core.messages import SampleBlock, StreamInfo

BLOCK = schema_of("Block")
FINITE = st.floats(allow_nan=False, allow_infinity=False)
MAYBE = st.none() | FINITE


@pytest.mark.parametrize("channels", [1, 3, 20])
def test_rows_of_samples_are_what_protobuf_itself_reads(channels):
    names = tuple(f"c{index}" for index in range(channels))
    schema = sample_schema(StreamInfo("arm.force", names, "N"))
    values = np.random.default_rng(0).normal(size=(5, channels))
    times = np.linspace(1, 2, 5)
    rows = schema.encode(times, values)
    for row, time, sample in zip(rows, times, values, strict=True):
        message = schema.message.FromString(row)
        assert message.t_s == time
        assert [getattr(message, f"{name}_n") for name in names] == list(sample)


def test_a_field_bears_the_unit_and_the_message_the_stream_and_the_log_is_foxgloves_own():
    schema = sample_schema(StreamInfo("board.accelerometer", ("z", "3d"), "m/s2"))
    assert schema.name == "touchbench.BoardAccelerometer"
    assert [field.name for field in schema.message.DESCRIPTOR.fields] == ["t_s", "z_m_s2", "_3d_m_s2"]
    log = log_schema()
    fields = {field.name: field.number for field in log.message.DESCRIPTOR.fields}
    assert log.name == "foxglove.Log"
    assert fields == {"timestamp": 1, "level": 2, "message": 3, "name": 4, "file": 5, "line": 6}


@pytest.mark.parametrize(
    ("name", "channels", "unit", "message", "fields"),
    [
        ("Waage ü.kraft", ("größe",), "µN", "Waage_dcKraft", ["gr_f6_dfe__b5n"]),
        ("2nd.force", ("fx", "fx "), "N", "_2ndForce", ["fx_n", "fx__n_2"]),
        ("-.-", ("%", "触"), "", "_", ["_", "_89e6"]),
    ],
)
def test_a_name_in_any_letters_is_one_that_protobuf_takes(name, channels, unit, message, fields):
    schema = sample_schema(StreamInfo(name, channels, unit))
    assert schema.name == f"touchbench.{message}"
    assert [field.name for field in schema.message.DESCRIPTOR.fields] == ["t_s", *fields]


@settings(max_examples=100, deadline=None)
@given(
    values=hnp.arrays(
        st.sampled_from([np.dtype("i4"), np.dtype("i8"), np.dtype("f8")]),
        st.tuples(st.integers(0, 5), st.integers(1, 3)),
    ),
    seq=st.integers(0, 2**63),
    rate_hz=st.floats(1e-3, 1e6),
    regular=st.booleans(),
    t0_s=FINITE,
    device_t0_s=MAYBE,
    arrival_s=MAYBE,
)
def test_a_block_comes_back_to_the_bit(*, values, seq, rate_hz, regular, t0_s, device_t0_s, arrival_s):
    block = SampleBlock(
        "board.load_cell",
        seq,
        t0_s,
        values,
        rate_hz if regular else None,
        None if regular else np.arange(len(values)) / 3,
        "N",
        1e-5,
        device_t0_s,
        arrival_s,
    )
    back = decode_block(BLOCK, "board.load_cell", encode_block(BLOCK, block))
    assert back.values.dtype == values.dtype
    assert back.values.tobytes() == values.tobytes()
    assert (back.times_s is None) == regular
    if not regular:
        assert np.array_equal(back.times_s, block.times_s)
    for name in ("stream", "seq", "t0_s", "rate_hz", "unit", "scale", "device_t0_s", "arrival_s"):
        assert getattr(back, name) == getattr(block, name)


@pytest.mark.parametrize(
    "crafted",
    [
        {"rate_hz": 0.0},
        {"rate_hz": float("inf")},
        {"t0_s": float("nan")},
        {"rate_hz": None, "times_s": np.array([1.0])},
        {"rate_hz": None, "times_s": np.array([1.0, np.inf])},
        {"values": np.zeros((2, 1), "S4")},
    ],
)
def test_a_block_that_no_driver_could_have_given_is_an_error(crafted):
    block = SampleBlock("a.b", 0, 0.0, np.zeros((2, 1)), 1000.0)
    with pytest.raises(ValueError, match=r"a\.b: "):
        decode_block(BLOCK, "a.b", encode_block(BLOCK, replace(block, **crafted)))
