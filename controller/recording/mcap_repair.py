"""Closes a recording whose program was killed, so that every reader of MCAP takes it and not ours alone."""

from __future__ import annotations

from pathlib import Path

from mcap.records import Attachment, Footer, Metadata

from controller.recording.lock import lock
from controller.recording.mcap_file import ChunkPlace, McapWriter, messages, records, topics

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
