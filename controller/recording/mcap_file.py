"""An MCAP file that is whole up to its last chunk, whenever the program dies.

The record types are those of the official `mcap` library. Its `Writer` builds every message as a
Python object (6 us each); equally long samples go through one NumPy record array here instead (0.2 us each).
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from io import BytesIO
from itertools import accumulate
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray

from controller.recording.lock import lock

MAGIC = b"\x89MCAP0\r\n"
"""First and last eight bytes of a file (MCAP specification, "Magic")."""

CHUNK_BYTES = 1 << 20
"""Uncompressed size at which a chunk is ended (the library's own default)."""

LARGEST_CHUNK_BYTES = 64 * CHUNK_BYTES
"""Largest chunk that is unpacked (assumption): a chunk ends with the block that fills it, and no block is so large."""

RECORD = struct.Struct("<BQ")
"""Head of a record: opcode, length of what follows."""

_FOOTER_BYTES = RECORD.size + 20 + len(MAGIC)
"""Length of the last record, with what ends the file."""

_MESSAGE_HEAD = [
    ("opcode", "u1"),
    ("length", "<u8"),
    ("channel", "<u2"),
    ("sequence", "<u4"),
    ("log_time", "<u8"),
    ("publish_time", "<u8"),
]
MESSAGE = struct.Struct("<BQHIQQ")
_ENTRY = struct.Struct("<QQ")  # log time, offset in the uncompressed chunk
INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
"""One message in a chunk's index: its log time, and where it begins in the chunk."""

_ALIKE = RECORD.size + 2
"""How much of the beginning of messages of one channel and one length is the same: opcode, length, channel, bytes."""

CHANNEL_AT, TIMES_AT = 9, (15, 23)
"""Where in a message's record its channel and its two times stand: behind opcode (1), length (8), sequence (4)."""


class Mirror(Protocol):
    """Gets what is written as well; it never raises and never waits."""

    def channel(
        self, number: int, topic: str, schema: tuple[str, bytes], metadata: Mapping[str, str]
    ) -> None:
        """A topic, with its schema's name and descriptors."""

    def message(self, number: int, log_time_ns: int, data: bytes) -> None:
        """A message of one of the topics."""


class McapWriter:
    """Appends chunks to a new file; every method that writes may raise `OSError`.

    Args:
        path: File to create.
        library: What wrote it, for the header.
        mirror: Gets topics and messages as well.
    """

    def __init__(self, path: Path, library: str, mirror: Mirror | None = None) -> None:
        self._mirror = mirror
        self._file = path.open("wb", buffering=0)
        with suppress(OSError):  # not every file system knows locks
            lock(self._file.fileno())  # as long as it is written: see `mcap_repair`
        self._offset = 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        # As they are written at the end: a campaign has 100,000 trials, and as objects they would take 1 kB each.
        self._chunks, self._metadata, self._attachments = bytearray(), bytearray(), bytearray()
        self._chunk_count = self._metadata_count = self._attachment_count = 0
        self._span_ns: tuple[int, int] | None = None
        self._counts: dict[int, int] = {}
        self._compressor = zstandard.ZstdCompressor(level=1)
        self._pieces: list[bytes] = []
        self._size = 0
        self._entries: dict[int, list[bytes]] = {}
        self._start_ns = self._end_ns = 0
        try:
            self._write(MAGIC + _encoded(Header(profile="", library=library)))
        except OSError:
            self._file.close()
            raise

    def add_schema(self, name: str, descriptors: bytes) -> int:
        """Add a protobuf schema (a serialised `FileDescriptorSet`); returns its number."""
        schema = Schema(id=len(self._schemas) + 1, data=descriptors, encoding="protobuf", name=name)
        self._schemas.append(schema)
        self._write(_encoded(schema))
        return schema.id

    def add_channel(self, topic: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Add a topic; returns its number."""
        channel = Channel(len(self._channels) + 1, topic, "protobuf", dict(metadata), schema_id)
        self._channels.append(channel)
        self._write(_encoded(channel))
        if self._mirror is not None:
            schema = self._schemas[schema_id - 1]
            self._mirror.channel(channel.id, topic, (schema.name, schema.data), metadata)
        return channel.id

    def add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        """Write a metadata record between two chunks, ending the present one."""
        self.end_chunk()
        self._write_metadata(_encoded(Metadata(name, dict(metadata))), name)

    def add_attachment(self, name: str, media_type: str, data: bytes, log_time_ns: int) -> None:
        """Write a file between two chunks, ending the present one."""
        self.end_chunk()
        self._write_attachment(_encoded(Attachment(log_time_ns, log_time_ns, name, media_type, data)))

    def add_message(self, channel: int, log_time_ns: int, data: bytes, sequence: int = 0) -> None:
        """Add one message to the present chunk."""
        head = MESSAGE.pack(
            Opcode.MESSAGE, len(data) + 22, channel, sequence & 0xFFFFFFFF, log_time_ns, log_time_ns
        )
        self._add(channel, head + data, _ENTRY.pack(log_time_ns, self._size), log_time_ns, log_time_ns)
        if self._mirror is not None:
            self._mirror.message(channel, log_time_ns, data)

    def add_messages(
        self,
        channel: int,
        log_times_ns: NDArray[np.int64],
        data: NDArray[np.uint8],
        sequence: NDArray[np.int64],
    ) -> None:
        """Add messages of equal length: times (n,), bytes (n, length), sequence numbers (n,)."""
        count, length = data.shape
        record = np.zeros(1, np.dtype([*_MESSAGE_HEAD, ("data", f"V{length}")]))
        record["opcode"] = Opcode.MESSAGE
        record["length"] = record.itemsize - RECORD.size
        record["channel"] = channel
        records = np.repeat(record, count)  # what is the same in all is not written field by field
        records["sequence"] = sequence & 0xFFFFFFFF
        records["log_time"] = records["publish_time"] = log_times_ns
        records["data"] = np.ascontiguousarray(data).view(f"V{length}")[:, 0]
        entries = np.empty(count, INDEX_ENTRY)
        entries["log_time"] = log_times_ns
        entries["offset"] = self._size + np.arange(count) * records.itemsize
        times = int(log_times_ns.min()), int(log_times_ns.max())
        self._add(channel, records.tobytes(), entries.tobytes(), *times)
        if self._mirror is not None:
            for time_ns, row in zip(log_times_ns.tolist(), data, strict=True):
                self._mirror.message(channel, time_ns, row.tobytes())

    def _add(self, channel: int, records: bytes, entries: bytes, start_ns: int, end_ns: int) -> None:
        self._start_ns = min(self._start_ns, start_ns) if self._pieces else start_ns
        self._end_ns = max(self._end_ns, end_ns) if self._pieces else end_ns
        self._pieces.append(records)
        self._entries.setdefault(channel, []).append(entries)
        self._size += len(records)
        if self._size >= CHUNK_BYTES:
            self.end_chunk()

    def add_chunk(self, plain: bytes, index: Mapping[int, bytes], log_times_ns: tuple[int, int]) -> None:
        """Write messages of another file as a chunk: their bytes, their index by channel, first and last time."""
        self.end_chunk()
        self._pieces, self._entries = [plain], {channel: [entries] for channel, entries in index.items()}
        self._start_ns, self._end_ns = log_times_ns
        self.end_chunk()

    def end_chunk(self) -> None:
        """Compress and write the present chunk, if it holds anything, with its index."""
        if not self._pieces:
            return
        plain = b"".join(self._pieces)
        indices = {channel: b"".join(parts) for channel, parts in self._entries.items()}
        self._pieces, self._size, self._entries = [], 0, {}
        start_ns, end_ns = self._start_ns, self._end_ns
        packed = self._compressor.compress(plain)
        chunk = _encoded(Chunk("zstd", packed, end_ns, start_ns, zlib.crc32(plain), len(plain)))
        offsets: dict[int, int] = {}
        pieces = [chunk]
        at = len(chunk)
        for channel, index in indices.items():
            offsets[channel] = self._offset + at
            head = RECORD.pack(Opcode.MESSAGE_INDEX, 6 + len(index)) + struct.pack("<HI", channel, len(index))
            pieces += [head, index]
            at += len(head) + len(index)
        self._note_chunk(
            ChunkIndex(
                chunk_length=len(chunk),
                chunk_start_offset=self._offset,
                compression="zstd",
                compressed_size=len(packed),
                message_end_time=end_ns,
                message_index_length=at - len(chunk),
                message_index_offsets=offsets,
                message_start_time=start_ns,
                uncompressed_size=len(plain),
            )
        )
        self._write(b"".join(pieces))
        for channel, index in indices.items():
            self._counts[channel] = self._counts.get(channel, 0) + len(index) // _ENTRY.size

    def adopt(self, opcode: int, record: bytes) -> None:
        """Take a schema, a channel, an attachment or a metadata record of another file as it stands there."""
        stream = ReadDataStream(BytesIO(record[RECORD.size :]))
        if opcode == Opcode.SCHEMA:
            self._schemas.append(Schema.read(stream))
        elif opcode == Opcode.CHANNEL:
            self._channels.append(Channel.read(stream))
        elif opcode == Opcode.ATTACHMENT:
            self._write_attachment(record)
            return
        else:
            self._write_metadata(record, Metadata.read(stream).name)
            return
        self._write(record)

    def adopt_chunk(self, record: bytes, index: Sequence[bytes]) -> None:
        """Take a chunk of another file, and the index that follows it, as they stand there."""
        chunk = Chunk.read(ReadDataStream(BytesIO(record[RECORD.size :])))
        parts = [MessageIndex.read(ReadDataStream(BytesIO(part[RECORD.size :]))) for part in index]
        starts = accumulate(map(len, index), initial=self._offset + len(record))
        self._note_chunk(
            ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=self._offset,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=sum(map(len, index)),
                message_index_offsets={part.channel_id: at for part, at in zip(parts, starts, strict=False)},
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        self._write(record + b"".join(index))
        for part in parts:
            self._counts[part.channel_id] = self._counts.get(part.channel_id, 0) + len(part.records)

    def sync(self) -> None:
        """End the chunk and see it on the disk."""
        self.end_chunk()
        os.fsync(self._file.fileno())

    def finish(self) -> None:
        """Write summary and footer, and close."""
        try:
            self.end_chunk()
            self._write(_encoded(DataEnd(data_section_crc=0)))
            self._write_summary()
            os.fsync(self._file.fileno())
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is, without a summary."""
        self._file.close()

    def _write_summary(self) -> None:
        statistics = Statistics(
            attachment_count=self._attachment_count,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunk_count,
            message_count=sum(self._counts.values()),
            message_end_time=(self._span_ns or (0, 0))[1],
            message_start_time=(self._span_ns or (0, 0))[0],
            metadata_count=self._metadata_count,
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, bytes | bytearray]] = [
            (Opcode.SCHEMA, b"".join(map(_encoded, self._schemas))),
            (Opcode.CHANNEL, b"".join(map(_encoded, self._channels))),
            (Opcode.STATISTICS, _encoded(statistics)),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, self._metadata),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
        ]
        start, crc, offsets = self._offset, 0, b""
        for opcode, data in groups:  # one by one: of 100,000 trials they are 40 MB
            offsets += _encoded(SummaryOffset(opcode, self._offset, len(data))) if data else b""
            crc = zlib.crc32(data, crc)
            self._write(data)
        offset_start = self._offset
        footer_head = RECORD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, offset_start)
        crc = zlib.crc32(offsets + footer_head, crc)
        self._write(offsets + _encoded(Footer(start, offset_start, crc)) + MAGIC)

    def _write_metadata(self, record: bytes, name: str) -> None:
        self._metadata += _encoded(MetadataIndex(self._offset, len(record), name))
        self._metadata_count += 1
        self._write(record)

    def _write_attachment(self, record: bytes) -> None:
        attachment = Attachment.read(ReadDataStream(BytesIO(record[RECORD.size :])))
        size, times = len(attachment.data), (attachment.log_time, attachment.create_time)
        index = AttachmentIndex(
            self._offset, len(record), *times, size, attachment.name, attachment.media_type
        )
        self._attachments += _encoded(index)
        self._attachment_count += 1
        self._write(record)

    def _note_chunk(self, chunk: ChunkIndex) -> None:
        start_ns, end_ns = self._span_ns or (chunk.message_start_time, chunk.message_end_time)
        self._span_ns = min(start_ns, chunk.message_start_time), max(end_ns, chunk.message_end_time)
        self._chunks += _encoded(chunk)
        self._chunk_count += 1

    def _write(self, data: bytes | bytearray) -> None:
        view = memoryview(data)
        while view:  # an unbuffered write may take a part only
            view = view[self._file.write(view) :]
        self._offset += len(data)


def _encoded(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def records(path: Path) -> Iterator[Channel | Metadata | tuple[int, int] | Footer]:
    """Walk the records of a file up to the last whole one.

    Yields:
        Channels and metadata as they come, each chunk as (offset, length) of its body, and the footer where
        the file has one: a file without was cut off.

    Raises:
        ValueError: not an MCAP file.
    """
    with path.open("rb") as file:
        for opcode, body, length in walk(path):
            if opcode == Opcode.CHUNK:
                yield body, length
            elif opcode in (Opcode.CHANNEL, Opcode.METADATA, Opcode.FOOTER):
                kind: Any = {Opcode.CHANNEL: Channel, Opcode.METADATA: Metadata}.get(Opcode(opcode), Footer)
                file.seek(body)
                yield kind.read(ReadDataStream(BytesIO(file.read(length))))


def topics_of(path: Path) -> list[tuple[Channel, Schema]]:
    """The topics of a whole file and their schemas; of its summary the beginning alone is read.

    Raises:
        ValueError: it was cut off.
    """
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _FOOTER_BYTES))
        end = file.read()
        if not end.endswith(MAGIC) or end[0] != Opcode.FOOTER:
            raise ValueError(f"{path}: cut off")
        file.seek(Footer.read(ReadDataStream(BytesIO(end[RECORD.size :]))).summary_start)
        schemas: dict[int, Schema] = {}
        found = []
        for record in StreamReader(file, skip_magic=True).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                found.append((record, schemas[record.schema_id]))
            else:
                break
    return found


def walk(path: Path) -> Iterator[tuple[int, int, int]]:
    """Each whole record up to the footer: opcode, where its body begins, and the body's length."""
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise ValueError(f"{path}: not an MCAP recording")
        offset, opcode = len(MAGIC), 0
        while offset + RECORD.size <= size and opcode != Opcode.FOOTER:
            file.seek(offset)
            opcode, length = RECORD.unpack(file.read(RECORD.size))
            body = offset + RECORD.size
            offset = body + length
            if offset <= size:
                yield opcode, body, length


def messages(path: Path, body: int, length: int, channels: frozenset[int]) -> Iterator[tuple[int, bytes]]:
    """Messages of one chunk on some channels, as (channel, data), in the order in which they were written.

    Raises:
        ValueError: the chunk's content is damaged; where it cannot even be parsed, the parsing library's own error.
    """
    with path.open("rb") as file:
        file.seek(body)
        plain = unpacked(file.read(length))
    offset = 0
    while offset < len(plain):
        _, record_length, channel, *_ = MESSAGE.unpack_from(plain, offset)
        end = offset + RECORD.size + record_length
        if channel in channels:
            yield channel, plain[offset + MESSAGE.size : end]
        elif plain[end : end + _ALIKE] == plain[offset : offset + _ALIKE]:
            end = _end_of_alike(plain, offset, end - offset)
        offset = end


def _end_of_alike(plain: bytes, offset: int, size: int) -> int:
    """Where messages of one channel, each of `size` bytes, end that follow each other from `offset` on: samples do."""
    several = 32
    while True:
        count = min(several, (len(plain) - offset) // size)
        heads = np.frombuffer(plain, np.uint8, count * size, offset).reshape(count, size)[:, :_ALIKE]
        others = np.flatnonzero((heads != heads[0]).any(axis=1))
        if len(others) or count < several:
            return offset + size * int(others[0] if len(others) else count)
        offset, several = offset + size * (count - 1), 4 * several


def unpacked(body: bytes) -> bytes:
    """The messages of a chunk's body, one after the other."""
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    size = zstandard.get_frame_parameters(chunk.data).content_size
    if not size == chunk.uncompressed_size <= LARGEST_CHUNK_BYTES:
        raise ValueError(f"it unpacks to {size} bytes instead of {chunk.uncompressed_size}")
    plain = zstandard.ZstdDecompressor().decompress(chunk.data)
    if zlib.crc32(plain) != chunk.uncompressed_crc:
        raise ValueError("its checksum is another")
    return plain


def message_heads(plain: bytes) -> Iterator[tuple[int, tuple[Any, ...]]]:
    """Where each message begins, and its head: opcode, length, channel, sequence and two times."""
    offset = 0
    while offset < len(plain):
        head = MESSAGE.unpack_from(plain, offset)
        yield offset, head
        offset += RECORD.size + head[1]
