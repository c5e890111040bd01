"""What is in a recording, described in the file itself: protobuf messages made from a few descriptors.

- one message a plotted sample, `t_s` and a double for each channel: what Foxglove and PlotJuggler plot;
- `touchbench.Block`: a sample block as the driver gave it, raw, for replay and for measures;
- `touchbench.Reading`: what a detector held against its threshold;
- `touchbench.Skipped`: a span in which a stream had no subscriber;
- `foxglove.Log`: what happened, in Foxglove's own schema, for its log panel.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from numpy.typing import NDArray

from drivers.core.messages import Floats, SampleBlock, StreamInfo

_Field = descriptor_pb2.FieldDescriptorProto
_TYPES = {
    "double": _Field.TYPE_DOUBLE,
    "uint64": _Field.TYPE_UINT64,
    "uint32": _Field.TYPE_UINT32,
    "string": _Field.TYPE_STRING,
    "bytes": _Field.TYPE_BYTES,
    "fixed32": _Field.TYPE_FIXED32,
}

READINGS = ("t_s", "statistic", "threshold")
"""Fields of a detector's reading."""

FIELDS: Mapping[str, Mapping[str, str]] = {
    "Block": {
        "seq": "uint64",
        "t0_s": "double",
        "channels": "uint32",
        "dtype": "string",
        "values": "bytes",
        "unit": "string",
        "scale": "double",
        "rate_hz": "optional double",
        "times_s": "repeated double",
        "device_t0_s": "optional double",
        "arrival_s": "optional double",
    },
    "State": {"t_s": "double", "state": "string"},
    "Skipped": {"stream": "string", "t0_s": "double", "t1_s": "double"},
}
"""Our messages, in the package `touchbench`, beside rows."""

TRIAL, TRIAL_END = "trial", "trial_end"
"""Metadata records before and behind the chunks of a trial."""

EVENTS, STATE, SKIPPED = "/events", "/state", "/skipped"
"""Topics that every recording may have."""

RAW, READ = "/raw/", "/detector/"
"""What topics of sample blocks and of detectors' readings begin with."""

LOG_LEVELS = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")
"""`foxglove.LogLevel`, in the order of its numbers."""


class Schema:
    """A protobuf message type: its full name, the class, and what an MCAP file stores of it."""

    def __init__(self, files: list[descriptor_pb2.FileDescriptorProto], name: str) -> None:
        pool = descriptor_pool.DescriptorPool()
        for file in files:
            pool.Add(file)
        self.name = name
        self.descriptors: bytes = descriptor_pb2.FileDescriptorSet(file=files).SerializeToString()
        self.message: Any = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))

    def pack(self, **fields: object) -> bytes:
        """A serialised message."""
        return bytes(self.message(**fields).SerializeToString())


def _file(package: str, message: str, fields: Mapping[str, str]) -> descriptor_pb2.FileDescriptorProto:
    name = f"{package}/{message}.proto"
    file = descriptor_pb2.FileDescriptorProto(name=name, package=package, syntax="proto3")
    described = file.message_type.add(name=message)
    for number, (name, kind) in enumerate(fields.items(), start=1):
        rule, _, plain = kind.rpartition(" ")
        field = described.field.add(name=name, number=number, label=_Field.LABEL_OPTIONAL)
        if plain in _TYPES:
            field.type = _TYPES[plain]
        else:
            field.type_name = plain
        if rule == "repeated":
            field.label = _Field.LABEL_REPEATED
        elif rule == "optional":  # proto3 marks presence by a oneof of one
            field.proto3_optional = True
            field.oneof_index = len(described.oneof_decl)
            described.oneof_decl.add(name=f"_{name}")
    return file


def schema_of(message: str) -> Schema:
    """One of `FIELDS`."""
    return Schema([_file("touchbench", message, FIELDS[message])], f"touchbench.{message}")


def log_schema() -> Schema:
    """`foxglove.Log`, field by field as in Foxglove's published message schemas."""
    stamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    level = descriptor_pb2.FileDescriptorProto(
        name="foxglove/LogLevel.proto", package="foxglove", syntax="proto3"
    )
    names = level.enum_type.add(name="LogLevel").value
    for number, name in enumerate(LOG_LEVELS):
        names.add(name=name, number=number)
    fields = {"timestamp": ".google.protobuf.Timestamp", "level": ".foxglove.LogLevel"}
    fields |= {"message": "string", "name": "string", "file": "string", "line": "fixed32"}
    log = _file("foxglove", "Log", fields)
    log.dependency.extend([stamp.name, level.name])
    return Schema([stamp, level, log], "foxglove.Log")


class RowSchema(Schema):
    """Messages of doubles alone, all fields of each in the file: all are equally long, and many are encoded at once."""

    def __init__(self, message: str, names: Sequence[str]) -> None:
        described = _file("touchbench", message, dict.fromkeys(names, "double"))
        super().__init__([described], f"touchbench.{message}")
        columns: list[tuple[Any, ...]] = []
        self._tags: list[NDArray[np.uint8]] = []
        for number in range(1, len(names) + 1):
            tag = number << 3 | 1  # wire type 1: eight bytes
            encoded = [tag] if tag < 0x80 else [tag & 0x7F | 0x80, tag >> 7]
            self._tags.append(np.array(encoded, np.uint8))
            columns += [(f"tag{number}", "u1", (len(encoded),)), (f"value{number}", "<f8")]
        self._row = np.dtype(columns)

    def encode(self, times_s: Floats, values: Floats) -> list[bytes]:
        """Times, shape (n,), and values, (n, fields - 1), as n serialised messages."""
        rows = np.empty(len(times_s), self._row)
        for number, (tag, column) in enumerate(zip(self._tags, (times_s, *values.T), strict=True), start=1):
            rows[f"tag{number}"] = tag
            rows[f"value{number}"] = column
        data, size = rows.tobytes(), self._row.itemsize
        return [data[begin : begin + size] for begin in range(0, len(data), size)]


def reading_schema() -> RowSchema:
    """What a detector held against its threshold."""
    return RowSchema("Reading", READINGS)


def sample_schema(info: StreamInfo) -> RowSchema:
    """One sample of a stream: `t_s` (bench time in the trial) and each channel, in the stream's unit:
    `board.load_cell` with channel `force` in N gives `BoardLoadCell.force_n`."""
    unit = _identifier(info.unit)
    names = {"tS": "t_s"}  # by their form in JSON, of which none may be there twice
    for number, channel in enumerate(info.channels, start=1):
        name = _identifier(f"{channel}_{unit}" if unit else channel)
        form = re.sub("_+(.?)", lambda found: found[1].upper(), name)
        names |= {f"{form}{number}": f"{name}_{number}"} if form in names else {form: name}
    message = "".join(part.capitalize() for part in re.split(r"\W|_", info.name))
    return RowSchema(_named(message), list(names.values()))


def _identifier(text: str) -> str:
    return _named(re.sub(r"\W+", "_", text.lower()).strip("_"))


def _named(text: str) -> str:
    """A name as protobuf takes it, in ASCII: of another letter its code."""
    name = "".join(each if each.isascii() else f"_{ord(each):x}" for each in text)
    return name if name and not name[0].isdigit() else f"_{name}"


def encode_block(schema: Schema, block: SampleBlock) -> bytes:
    """Serialise a block exactly: raw values in their own type, little-endian."""
    values = np.ascontiguousarray(block.values)
    values = values.astype(values.dtype.newbyteorder("<"), copy=False)
    return schema.pack(
        seq=block.seq,
        t0_s=block.t0_s,
        channels=values.shape[1],
        dtype=values.dtype.str,
        values=values.tobytes(),
        unit=block.unit,
        scale=block.scale,
        rate_hz=block.rate_hz,
        times_s=block.times_s,
        device_t0_s=block.device_t0_s,
        arrival_s=block.arrival_s,
    )


def decode_block(schema: Schema, stream: str, data: bytes) -> SampleBlock:
    """The block that `encode_block` was given.

    Raises:
        ValueError: no block that a driver could have given.
    """
    message = schema.message.FromString(data)
    regular = message.HasField("rate_hz")
    block = SampleBlock(
        stream=stream,
        seq=message.seq,
        t0_s=message.t0_s,
        values=np.frombuffer(message.values, np.dtype(message.dtype)).reshape(-1, message.channels),
        rate_hz=message.rate_hz if regular else None,
        times_s=None if regular else np.array(message.times_s),
        unit=message.unit,
        scale=message.scale,
        device_t0_s=message.device_t0_s if message.HasField("device_t0_s") else None,
        arrival_s=message.arrival_s if message.HasField("arrival_s") else None,
    )
    if block.values.dtype.kind not in "iuf":
        raise ValueError(f"{stream}: its values are no numbers ({message.dtype})")
    if regular and not 0.0 < message.rate_hz < np.inf:
        raise ValueError(f"{stream}: a rate of {message.rate_hz} Hz")
    times_s = block.times
    if len(times_s) != len(block) or not np.isfinite(times_s).all():
        raise ValueError(f"{stream}: {len(block)} samples with times that are none of theirs")
    return block
