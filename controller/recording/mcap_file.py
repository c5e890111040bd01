"""A recording as an MCAP file: written by the `mcap` library, read again whole or cut off at any byte.

A chunk holds messages of one trial; nothing is unpacked before it is asked for.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from io import BytesIO
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import Writer

from controller.recording.run_folder import lock

if TYPE_CHECKING:
    from controller.watching.foxglove import FoxgloveStream

LIBRARY = "touchbench"
"""What the header of a file names as its writer."""

MAGIC = b"\x89MCAP0\r\n"
"""First and last eight bytes of a file (MCAP specification, "Magic")."""

LARGEST_CHUNK_BYTES = 64 << 20
"""Largest chunk that is unpacked (assumption): a chunk ends with the message that fills 1 MiB, and none is so large."""

_RECORD = struct.Struct("<BQ")
"""Head of a record: opcode, length of what follows."""

_MESSAGE = struct.Struct("<HIQQ")
"""Head of a message's record: channel, sequence, log time, time of publishing."""

_FOOTER_BYTES = _RECORD.size + 20 + len(MAGIC)
"""Length of the last record, with what ends the file."""

_KINDS: Mapping[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: Attachment,
    Opcode.FOOTER: Footer,
}

Topic = tuple[Channel, Schema]
McapMessage = tuple[int, int, int, bytes]
"""Number of its channel, sequence, log time (ns), data."""


class ChunkPlace(NamedTuple):
    """Where the body of a chunk stands in a file: offset and length, bytes."""

    body: int
    length: int


class McapWriter:
    """A new file, in place of none, locked as long as it is written; every method that writes may raise `OSError`.

    What is written goes to the live stream too, which never raises and never waits.
    """

    def __init__(self, path: Path, mirror: FoxgloveStream | None = None) -> None:
        self._mirror = mirror
        self._file = path.open("xb")
        with suppress(OSError):  # not every file system knows locks
            lock(self._file.fileno())  # see `close_cut`
        self._writer = Writer(self._file)
        self._schemas: dict[tuple[str, bytes], int] = {}
        self._topics: dict[str, int] = {}
        try:
            self._writer.start(library=LIBRARY)
            self._writer.flush()
        except OSError:
            self.abandon()
            raise

    def topic(self, topic: str, schema: str, descriptors: bytes, metadata: Mapping[str, str]) -> int:
        """The number of a topic, which is added when it is first asked for.

        Args:
            schema: Full name of its protobuf messages.
            descriptors: A serialised `FileDescriptorSet` of these.
        """
        if topic not in self._topics:
            described = schema, descriptors
            if described not in self._schemas:
                self._schemas[described] = self._writer.register_schema(schema, "protobuf", descriptors)
            kind = self._schemas[described]
            self._topics[topic] = number = self._writer.register_channel(
                topic, "protobuf", kind, dict(metadata)
            )
            if self._mirror is not None:
                self._mirror.channel(number, topic, described, metadata)
        return self._topics[topic]

    def add(self, channel: int, log_time_ns: int, data: bytes, sequence: int = 0) -> None:
        """Add a message to the present chunk; one that holds 1 MiB is ended."""
        self._writer.add_message(channel, log_time_ns, data, log_time_ns, sequence & 0xFFFFFFFF)
        if self._mirror is not None:
            self._mirror.message(channel, log_time_ns, data)

    def add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        """Write a metadata record between two chunks, ending the present one."""
        self.flush()
        self._writer.add_metadata(name, dict(metadata))

    def attach(self, name: str, media_type: str, data: bytes, log_time_ns: int) -> None:
        """Write a file between two chunks, ending the present one."""
        self.flush()
        self._writer.add_attachment(log_time_ns, log_time_ns, name, media_type, data)

    def flush(self, *, sync: bool = False) -> None:
        """End the chunk and hand it to the kernel, and with `sync` see it on the disk."""
        self._writer.flush()
        if sync:
            os.fsync(self._file.fileno())

    def finish(self) -> None:
        """Write summary and footer, and close."""
        try:
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file as it is, without a summary; never raises."""
        with suppress(OSError):
            self._file.close()


def records(path: Path) -> Iterator[McapRecord | ChunkPlace]:
    """The records outside of chunks up to the last whole one, and where each chunk stands; a file without a footer was
    cut off.

    Raises:
        ValueError: not an MCAP file.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise ValueError(f"{path}: not an MCAP recording")
        offset, opcode = len(MAGIC), 0
        while offset + _RECORD.size <= size and opcode != Opcode.FOOTER:
            file.seek(offset)
            opcode, length = _RECORD.unpack(file.read(_RECORD.size))
            body = offset + _RECORD.size
            offset = body + length
            if offset > size:
                return
            if opcode == Opcode.CHUNK:
                yield ChunkPlace(body, length)
            elif opcode == Opcode.MESSAGE:
                yield Message.read(ReadDataStream(BytesIO(file.read(length))), length)
            elif opcode in _KINDS:
                yield _KINDS[opcode].read(ReadDataStream(BytesIO(file.read(length))))


def topics(path: Path) -> dict[int, Topic]:
    """The channels of a file and their schemas, by the channel's number: out of the summary, of which the beginning
    alone is read; where there is none, as in a file that was cut off, out of the chunks."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _FOOTER_BYTES))
        end = file.read()
        if end.endswith(MAGIC) and end[0] == Opcode.FOOTER:
            file.seek(Footer.read(ReadDataStream(BytesIO(end[_RECORD.size :]))).summary_start or len(MAGIC))
            if found := _channels(StreamReader(file, skip_magic=True).records):
                return found
    return _channels(_defined(path))


def _channels(found: Iterator[Any]) -> dict[int, Topic]:
    """Those that stand first, with their schemas."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Topic] = {}
    for record in takewhile(lambda each: isinstance(each, Schema | Channel), found):
        if isinstance(record, Schema):
            schemas[record.id] = record
        else:
            channels[record.id] = record, schemas.get(record.schema_id)  # type: ignore[assignment] # one of JSON has none
    return channels


def _defined(path: Path) -> Iterator[Schema | Channel]:
    """The schemas and channels of a file, in its chunks or outside of them."""
    for record in records(path):
        if isinstance(record, Schema | Channel):
            yield record
        elif isinstance(record, ChunkPlace):
            plain = _unpacked(path, record)
            for opcode, body, end in _inside(plain):
                if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    yield _KINDS[opcode].read(ReadDataStream(BytesIO(plain[body:end])))


def messages(path: Path, record: McapRecord | ChunkPlace) -> Iterator[McapMessage]:
    """The messages of a chunk, in the order in which they were written, or one outside of chunks; no other record has
    any.

    Raises:
        ValueError: the chunk is damaged; where it cannot even be parsed, the parsing library's own error.
    """
    if isinstance(record, Message):
        yield record.channel_id, record.sequence, record.log_time, record.data
    elif isinstance(record, ChunkPlace):
        plain = _unpacked(path, record)
        for opcode, body, end in _inside(plain):
            if opcode == Opcode.MESSAGE:
                channel, sequence, log_time_ns, _ = _MESSAGE.unpack_from(plain, body)
                yield channel, sequence, log_time_ns, plain[body + _MESSAGE.size : end]


def _inside(plain: bytes) -> Iterator[tuple[int, int, int]]:
    """Each record of a chunk's content: opcode, and where its body begins and ends."""
    end = 0
    while end < len(plain):
        opcode, length = _RECORD.unpack_from(plain, end)
        body = end + _RECORD.size
        end = body + length
        yield opcode, body, end


def _unpacked(path: Path, place: ChunkPlace) -> bytes:
    with path.open("rb") as file:
        file.seek(place.body)
        chunk = Chunk.read(ReadDataStream(BytesIO(file.read(place.length))))
    size, claimed = len(chunk.data), chunk.uncompressed_size
    if chunk.compression:
        size = claimed
    if chunk.compression == "zstd":
        size = zstandard.get_frame_parameters(chunk.data).content_size
    if size not in (claimed, zstandard.CONTENTSIZE_UNKNOWN) or claimed > LARGEST_CHUNK_BYTES:
        raise ValueError(f"it unpacks to {size} bytes instead of {claimed}")
    stream, length = get_chunk_data_stream(chunk)
    plain: bytes = stream.read(length)
    if chunk.uncompressed_crc and zlib.crc32(plain) != chunk.uncompressed_crc:
        raise ValueError("its checksum is another")
    return plain


CLOSED_AFTERWARDS = "closed_afterwards"
"""Name of the metadata record in a file that was cut off and closed later (`close_cut`)."""


def close_cut(path: Path) -> bool:
    """Close a file that was cut off, up to its last whole chunk, so that every reader of MCAP takes it.

    The file is replaced whole or not at all. One that is being written, or has its footer, is left alone.

    Returns:
        Whether it was closed now.

    Raises:
        ValueError: no MCAP file, or a chunk is damaged.
        OSError: it cannot be read, or no second one be written beside it.
    """
    with path.open("rb") as cut:
        try:
            lock(cut.fileno())
        except OSError:  # its writer lives, or is not to be asked
            return False
        if any(isinstance(record, Footer) for record in records(path)):
            return False
        whole = path.with_suffix(".mcap.tmp")
        whole.unlink(missing_ok=True)
        try:
            writer = McapWriter(whole)
            try:
                _copy(path, writer)
                writer.add_metadata(CLOSED_AFTERWARDS, {})
                writer.finish()
            finally:
                writer.abandon()
            whole.replace(path)
        finally:
            whole.unlink(missing_ok=True)
    return True


def _copy(path: Path, writer: McapWriter) -> None:
    """Every whole record of a cut file."""
    numbers = {
        number: writer.topic(channel.topic, schema.name, schema.data, channel.metadata)
        for number, (channel, schema) in topics(path).items()
    }
    for record in records(path):
        if isinstance(record, ChunkPlace):
            for channel, sequence, log_time_ns, data in messages(path, record):
                writer.add(numbers[channel], log_time_ns, data, sequence)
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            writer.attach(record.name, record.media_type, record.data, record.log_time)
