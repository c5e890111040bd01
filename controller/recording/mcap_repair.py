"""Closes a recording whose program was killed, so that every reader of MCAP takes it and not ours alone."""

from __future__ import annotations

from pathlib import Path

from mcap.opcode import Opcode

from controller.recording.lock import lock
from controller.recording.mcap_file import MESSAGE, RECORD, McapWriter, message_heads, unpacked, walk

CLOSED_AFTERWARDS = "closed_afterwards"
"""Name of the metadata record in a file that was cut off and closed later (`close_cut`)."""


def close_cut(path: Path) -> bool:
    """Close a file that was cut off, up to its last whole chunk, so that every reader of MCAP takes it.

    The file is replaced whole or not at all. One that is being written, or has its footer, is left alone.

    Returns:
        Whether it was closed now.

    Raises:
        ValueError: no MCAP file, or its last chunk is damaged.
        OSError: it cannot be read, or no second one be written beside it.
    """
    with path.open("rb") as cut:
        try:
            lock(cut.fileno())
        except OSError:  # its writer lives, or is not to be asked
            return False
        if any(opcode == Opcode.FOOTER for opcode, _, _ in walk(path)):
            return False
        whole = path.with_suffix(".mcap.tmp")
        try:
            writer = McapWriter(whole, library="touchbench")
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
    """Every whole record of a cut file; the last chunk, whose index may be cut, is written anew."""
    chunk: tuple[bytes, list[bytes]] | None = None
    with path.open("rb") as file:
        for opcode, body, length in walk(path):
            file.seek(body - RECORD.size)
            record = file.read(RECORD.size + length)
            if opcode == Opcode.MESSAGE_INDEX and chunk is not None:
                chunk[1].append(record)
                continue
            if chunk is not None:
                writer.adopt_chunk(*chunk)
                chunk = None
            if opcode == Opcode.CHUNK:
                chunk = record, []
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.ATTACHMENT):
                writer.adopt(opcode, record)
    if chunk is None:
        return
    plain = unpacked(chunk[0][RECORD.size :])
    for offset, (_, record_length, channel, sequence, log_time_ns, _) in message_heads(plain):
        data = plain[offset + MESSAGE.size : offset + RECORD.size + record_length]
        writer.add_message(channel, log_time_ns, data, sequence)
