import io
import zlib

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Footer, Metadata

from controller.recording.mcap_file import CHUNK_BYTES, LARGEST_CHUNK_BYTES, McapWriter, messages, records


def write(path, *, chunks=3, per_chunk=4):
    """A file with `chunks` chunks on one channel; message k of chunk c is `c.k`; returns the messages."""
    writer = McapWriter(path, library="test")
    schema = writer.add_schema("s", b"")
    channel = writer.add_channel("/a", schema, {"unit": "N"})
    written = []
    for chunk in range(chunks):
        writer.add_metadata("trial", {"trial": str(chunk)})
        for index in range(per_chunk):
            written.append(f"{chunk}.{index}".encode())
            writer.add_message(channel, 1000 * chunk + index, written[-1], index)
        writer.end_chunk()
    writer.finish()
    return written


def read(path):
    found, footer = [], False
    for record in records(path):
        if isinstance(record, tuple):
            found += [data for _, data in messages(path, *record, frozenset({1}))]
        footer = isinstance(record, Footer)
    return found, footer


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "whole.mcap"
    written = write(path)
    return path.read_bytes(), written


def test_the_librarys_own_reader_finds_every_message_in_the_order_of_time(tmp_path):
    path = tmp_path / "a.mcap"
    written = write(path)
    reader = make_reader(io.BytesIO(path.read_bytes()), validate_crcs=True)
    found = [(message.log_time, message.sequence, message.data) for _, _, message in reader.iter_messages()]
    assert found == [(1000 * (k // 4) + k % 4, k % 4, text) for k, text in enumerate(written)]
    summary = reader.get_summary()
    assert summary.statistics.message_count == 12
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (0, 2003)
    assert [each.name for each in reader.iter_metadata()] == ["trial"] * 3


def test_the_librarys_reader_can_seek_by_time_through_the_index(tmp_path):
    path = tmp_path / "a.mcap"
    write(path)
    with path.open("rb") as file:
        found = [m.data for _, _, m in make_reader(file).iter_messages(starting_at=1001, ending_before=1003)]
    assert found == [b"1.1", b"1.2"]


def test_equally_long_messages_written_together_read_as_if_written_one_by_one(tmp_path):
    rows = np.arange(40, dtype=np.uint8).reshape(10, 4)
    times = np.arange(10) * 7
    contents = []
    for together in (True, False):
        path = tmp_path / f"{together}.mcap"
        writer = McapWriter(path, library="test")
        channel = writer.add_channel("/a", writer.add_schema("s", b""), {})
        if together:
            writer.add_messages(channel, times, rows, np.arange(10) + 2**32 - 5)
        else:
            for index in range(10):
                writer.add_message(channel, int(times[index]), rows[index].tobytes(), index + 2**32 - 5)
        writer.finish()
        contents.append(path.read_bytes())
    assert contents[0] == contents[1]


@given(
    st.lists(
        st.tuples(st.integers(1, 3), st.integers(0, 3), st.sampled_from((1, 2, 31, 32, 33, 200))),
        min_size=1,
        max_size=8,
    ),
    st.frozensets(st.integers(1, 3)),
)
@settings(max_examples=100, deadline=None)
def test_messages_of_some_channels_are_found_among_any_number_of_others(tmp_path_factory, runs, wanted):
    path = tmp_path_factory.mktemp("mcap") / "a.mcap"
    writer = McapWriter(path, library="test")
    schema = writer.add_schema("s", b"")
    for topic in ("/a", "/b", "/c"):
        writer.add_channel(topic, schema, {})
    written = []
    for channel, length, count in runs:
        for _ in range(count):
            written.append((channel, len(written).to_bytes(3, "big")[:length]))
            writer.add_message(channel, len(written), written[-1][1])
    writer.finish()
    (chunk,) = (record for record in records(path) if isinstance(record, tuple))
    assert list(messages(path, *chunk, wanted)) == [each for each in written if each[0] in wanted]


def test_a_chunk_ends_by_itself_when_it_is_large(tmp_path):
    path = tmp_path / "a.mcap"
    writer = McapWriter(path, library="test")
    channel = writer.add_channel("/a", writer.add_schema("s", b""), {})
    for index in range(3):
        writer.add_message(channel, index, bytes(CHUNK_BYTES))
    chunks = [record for record in records(path) if isinstance(record, tuple)]
    writer.abandon()
    assert len(chunks) == 3


def test_channels_and_metadata_come_out_as_they_went_in(tmp_path):
    path = tmp_path / "a.mcap"
    write(path, chunks=1)
    found = list(records(path))
    channel = next(record for record in found if isinstance(record, Channel))
    assert (channel.topic, channel.metadata) == ("/a", {"unit": "N"})
    assert [record.metadata for record in found if isinstance(record, Metadata)] == [{"trial": "0"}]


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_file_cut_at_any_byte_is_read_up_to_its_last_whole_chunk(whole, tmp_path_factory, data):
    content, written = whole
    cut = data.draw(st.integers(8, len(content) - 1))
    path = tmp_path_factory.getbasetemp() / "cut.mcap"
    path.write_bytes(content[:cut])
    found, _ = read(path)
    assert found == written[: len(found)]
    assert len(found) % 4 == 0
    ends = [body + length for body, length in (r for r in records_of(content, path) if isinstance(r, tuple))]
    assert len(found) == 4 * sum(end <= cut for end in ends)


def records_of(content, path):
    path.write_bytes(content)
    return list(records(path))


def test_a_cut_file_has_no_footer_and_a_whole_one_has(whole, tmp_path):
    content, written = whole
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    assert read(path) == (written, True)
    path.write_bytes(content[:-40])
    assert read(path) == (written, False)


def test_a_flipped_byte_in_a_chunk_is_an_error_and_never_a_number(tmp_path):
    path = tmp_path / "a.mcap"
    writer = McapWriter(path, library="test")
    channel = writer.add_channel("/a", writer.add_schema("s", b""), {})
    writer.add_message(channel, 0, np.random.default_rng(1).bytes(4000))  # random: stored, not compressed
    writer.finish()
    content = bytearray(path.read_bytes())
    content[1000] ^= 1
    path.write_bytes(content)
    chunk = next(record for record in records(path) if isinstance(record, tuple))
    with pytest.raises(ValueError, match="its checksum is another"):
        list(messages(path, *chunk, frozenset({1})))


def test_another_file_is_refused_by_name(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_text("trial,outcome\n")
    with pytest.raises(ValueError, match=r"a\.mcap: not an MCAP recording"):
        list(records(path))


@pytest.mark.parametrize(
    ("size", "claimed"), [(1000, 999), (LARGEST_CHUNK_BYTES + 1, LARGEST_CHUNK_BYTES + 1)]
)
def test_a_chunk_that_unpacks_to_more_than_it_claims_or_than_any_of_ours_is_not_unpacked(
    tmp_path, size, claimed
):
    packed = zstandard.compress(bytes(size))
    builder = RecordBuilder()
    Chunk("zstd", packed, 0, 0, zlib.crc32(bytes(size)), claimed).write(builder)
    path = tmp_path / "a.mcap"
    record = builder.end()
    path.write_bytes(record)
    with pytest.raises(ValueError, match=f"it unpacks to {size} bytes instead of {claimed}"):
        list(messages(path, 9, len(record) - 9, frozenset({1})))
