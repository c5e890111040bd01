import io
import zlib

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Chunk, Footer, Metadata

from controller.recording.mcap_file import (
    LARGEST_CHUNK_BYTES,
    ChunkPlace,
    McapWriter,
    messages,
    records,
    topics,
)


def write(path, *, chunks=3, per_chunk=4):
    """A file with `chunks` chunks on one channel; message k of chunk c is `c.k`; returns the messages."""
    writer = McapWriter(path)
    written = []
    for chunk in range(chunks):
        writer.add_metadata("trial", {"trial": str(chunk)})
        for index in range(per_chunk):
            written.append(f"{chunk}.{index}".encode())
            writer.add(writer.topic("/a", "s", b"", {"unit": "N"}), 1000 * chunk + index, written[-1], index)
        writer.flush()
    writer.finish()
    return written


def read(path):
    found, footer = [], False
    for record in records(path):
        if isinstance(record, ChunkPlace):
            found += [data for *_, data in messages(path, record)]
        footer = isinstance(record, Footer)
    return found, footer


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "whole.mcap"
    written = write(path)
    return path.read_bytes(), written


def test_the_librarys_own_reader_finds_every_message_in_the_order_of_time(whole):
    content, written = whole
    reader = make_reader(io.BytesIO(content), validate_crcs=True)
    found = [(message.log_time, message.sequence, message.data) for _, _, message in reader.iter_messages()]
    assert found == [(1000 * (k // 4) + k % 4, k % 4, text) for k, text in enumerate(written)]
    assert reader.get_summary().statistics.message_count == 12
    sought = [m.data for _, _, m in reader.iter_messages(starting_at=1001, ending_before=1003)]
    assert sought == [b"1.1", b"1.2"]


def test_channels_and_metadata_come_out_as_they_went_in_also_of_a_file_that_was_cut_off(whole, tmp_path):
    path = tmp_path / "a.mcap"
    for content in (whole[0], whole[0][:-60]):
        path.write_bytes(content)
        ((channel, schema),) = topics(path).values()
        assert (channel.topic, channel.metadata, schema.name) == ("/a", {"unit": "N"}, "s")
        noted = [record.metadata for record in records(path) if isinstance(record, Metadata)]
        assert noted == [{"trial": str(trial)} for trial in range(3)]


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_file_cut_at_any_byte_is_read_up_to_its_last_whole_chunk(whole, tmp_path_factory, data):
    content, written = whole
    cut = data.draw(st.integers(8, len(content) - 1))
    path = tmp_path_factory.getbasetemp() / "cut.mcap"
    path.write_bytes(content)
    ends = [chunk.body + chunk.length for chunk in records(path) if isinstance(chunk, ChunkPlace)]
    path.write_bytes(content[:cut])
    found, _ = read(path)
    assert found == written[: 4 * sum(end <= cut for end in ends)]


def test_a_cut_file_has_no_footer_and_a_whole_one_has(whole, tmp_path):
    content, written = whole
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    assert read(path) == (written, True)
    path.write_bytes(content[:-40])
    assert read(path) == (written, False)


def test_a_flipped_byte_in_a_chunk_is_an_error_and_never_a_number(tmp_path):
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    # random: stored, not compressed
    writer.add(writer.topic("/a", "s", b"", {}), 0, np.random.default_rng(1).bytes(4000))
    writer.finish()
    content = bytearray(path.read_bytes())
    content[1000] ^= 1
    path.write_bytes(content)
    chunk = next(record for record in records(path) if isinstance(record, ChunkPlace))
    with pytest.raises(ValueError, match="its checksum is another"):
        list(messages(path, chunk))


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
        list(messages(path, ChunkPlace(9, len(record) - 9)))
