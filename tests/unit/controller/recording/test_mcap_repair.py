"""A recording that was cut off at any byte is closed for every reader, and nothing that is whole in it is lost."""

import io
import shutil

import pytest
from mcap.reader import NonSeekingReader, make_reader

from controller.recording.mcap_file import McapWriter, close_cut
from tests.unit.controller.recording.test_mcap_file import read, write


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "recording.mcap"
    return write(path), path.read_bytes()


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
    written, data = whole
    path = tmp_path / "recording.mcap"
    reader = make_reader(io.BytesIO(data))
    end = reader.get_summary().chunk_indexes[-1]
    last = end.chunk_start_offset + end.chunk_length + end.message_index_length
    for cut in range(8, last + 30):
        path.write_bytes(data[:cut])
        before, footer = read(path)
        assert not footer
        assert close_cut(path)
        assert read(path) == (before, True)
        assert by_the_library(path.read_bytes()) == before
    assert before == written


def test_a_whole_file_is_left_alone(tmp_path, whole):
    path = tmp_path / "recording.mcap"
    path.write_bytes(whole[1])
    assert not close_cut(path)
    assert path.read_bytes() == whole[1]


def test_a_file_is_closed_once(tmp_path, whole):
    path = tmp_path / "recording.mcap"
    path.write_bytes(whole[1][:-60])
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


def test_a_file_that_cannot_be_closed_stays_as_it_was(tmp_path, whole, monkeypatch):
    path = tmp_path / "recording.mcap"
    path.write_bytes(whole[1][:-60])

    def full(self):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(McapWriter, "finish", full)
    with pytest.raises(OSError, match="No space left"):
        close_cut(path)
    assert [each.name for each in tmp_path.iterdir()] == ["recording.mcap"]
    assert path.read_bytes() == whole[1][:-60]


def test_a_file_whose_last_chunk_is_damaged_stays_as_it_was(tmp_path, whole):
    path = tmp_path / "recording.mcap"
    data = bytearray(whole[1])
    end = make_reader(io.BytesIO(whole[1])).get_summary().chunk_indexes[-1]
    data[end.chunk_start_offset + end.chunk_length - 3] ^= 0xFF
    path.write_bytes(data[: end.chunk_start_offset + end.chunk_length])
    shutil.copy(path, tmp_path / "before")
    with pytest.raises(Exception, match=r"checksum|decompress"):
        close_cut(path)
    assert path.read_bytes() == (tmp_path / "before").read_bytes()
