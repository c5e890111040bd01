"""Recordings: what is in a file, whole, cut off and repaired; its streams as series."""

import io
import zlib

import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, Footer, Metadata

from controller.recording.mcap_file import (
    LARGEST_CHUNK_BYTES,
    ChunkPlace,
    McapWriter,
    close_cut,
    messages,
    records,
    topics,
)
from controller.recording.series import Gap, Span, TrialRecording
from drivers.core.messages import SampleBlock


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


def test_a_flipped_byte_in_a_chunk_is_an_error_and_another_file_is_refused_by_name(tmp_path):
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
    path = tmp_path / "a.mcap"
    path.write_text("trial,outcome\n")
    with pytest.raises(ValueError, match=r"a\.mcap: not an MCAP recording"):
        list(records(path))


@pytest.mark.parametrize(("size", "claimed"), [(1000, 999), (MOST := LARGEST_CHUNK_BYTES + 1, MOST)])
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


def by_the_library(data):
    """What both of the library's readers find, and the summary's own count."""
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    sought = [message.data for _, _, message in reader.iter_messages()]
    streamed = [message.data for _, _, message in NonSeekingReader(io.BytesIO(data)).iter_messages()]
    assert streamed == sought
    assert reader.get_summary().statistics.message_count == len(sought)
    assert {each.topic for each in reader.get_summary().channels.values()} <= {"/a"}
    return sought


def test_a_file_cut_at_any_byte_is_closed_with_all_that_is_whole_in_it(tmp_path, whole):
    data, written = whole
    path = tmp_path / "recording.mcap"
    reader = make_reader(io.BytesIO(data))
    end = reader.get_summary().chunk_indexes[-1]
    last = end.chunk_start_offset + end.chunk_length + end.message_index_length
    path.write_bytes(data)
    assert read(path) == (written, True)
    ends = [chunk.body + chunk.length for chunk in records(path) if isinstance(chunk, ChunkPlace)]
    for cut in range(8, last + 30):
        path.write_bytes(data[:cut])
        before, footer = read(path)
        assert (before, footer) == (written[: 4 * sum(end <= cut for end in ends)], False)
        assert close_cut(path)
        assert read(path) == (before, True)
        assert by_the_library(path.read_bytes()) == before


def test_a_file_is_closed_once_and_a_whole_one_is_left_alone(tmp_path, whole):
    path = tmp_path / "recording.mcap"
    path.write_bytes(whole[0])
    assert not close_cut(path)
    assert path.read_bytes() == whole[0]
    path.write_bytes(whole[0][:-60])
    assert [close_cut(path), close_cut(path)] == [True, False]


def test_a_file_that_is_being_written_is_left_alone(tmp_path):
    path = tmp_path / "recording.mcap"
    writer = McapWriter(path)
    writer.add_metadata("trial", {})
    before = path.read_bytes()
    assert not close_cut(path)
    assert path.read_bytes() == before
    writer.abandon()
    assert close_cut(path)


def test_a_file_that_cannot_be_closed_or_whose_last_chunk_is_damaged_stays_as_it_was(
    tmp_path, whole, monkeypatch
):
    path = tmp_path / "recording.mcap"
    data = bytearray(whole[0])
    end = make_reader(io.BytesIO(whole[0])).get_summary().chunk_indexes[-1]
    data[end.chunk_start_offset + end.chunk_length - 3] ^= 0xFF
    path.write_bytes(data[: end.chunk_start_offset + end.chunk_length])
    before = path.read_bytes()
    with pytest.raises(Exception, match=r"checksum|decompress"):
        close_cut(path)
    assert path.read_bytes() == before
    path = tmp_path / "recording.mcap"
    path.write_bytes(whole[0][:-60])

    def full(self):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(McapWriter, "finish", full)
    with pytest.raises(OSError, match="No space left"):
        close_cut(path)
    assert [each.name for each in tmp_path.iterdir()] == ["recording.mcap"]
    assert path.read_bytes() == whole[0][:-60]


def block(seq, count, *, rate_hz=1000.0):
    values = np.arange(seq, seq + count, dtype=np.int32).reshape(-1, 1)
    return SampleBlock("board.load_cell", seq, seq / rate_hz, values, rate_hz, unit="N", scale=0.5)


def recorded(*blocks):
    recording = TrialRecording(1)
    for each in blocks:
        recording.add(each)
    return recording


def test_a_stream_is_its_blocks_in_its_unit_and_empty_ones_change_nothing():
    recording = recorded(block(0, 3), block(3, 0), block(3, 2))
    series = recording.stream("board.load_cell")
    assert series.unit == "N"
    assert series.values[:, 0].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert np.allclose(series.times_s, np.arange(5) / 1000, atol=1e-15)
    assert series.gaps == ()
    assert len(recording.blocks("board.load_cell")) == 3
    assert recorded().stream("board.load_cell").values.shape == (0, 1), "not recorded"


def test_a_lost_block_is_a_gap_a_skipped_span_none_and_between_takes_the_first_instant_alone():
    assert recorded(block(0, 10), block(15, 5)).stream("board.load_cell").gaps == (Gap(0.009, 0.015, 5),)
    recording = recorded(block(0, 10), block(1000, 5), block(1010, 5))
    recording.skip("board.load_cell", 0.010, 1.0)
    series = recording.stream("board.load_cell")
    assert series.gaps == (Gap(1.004, 1.01, 5),), "it excuses no loss elsewhere"
    assert series.skipped == (Span(0.010, 1.0),)
    series = recorded(block(0, 10), block(20, 10)).stream("board.load_cell")
    part = series.between(0.002, 0.005)
    assert np.allclose(part.times_s, [0.002, 0.003, 0.004], atol=1e-15)
    assert part.gaps == ()
    assert len(series.between(0.0, 0.1).gaps) == 1
