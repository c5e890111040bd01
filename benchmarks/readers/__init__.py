"""Whether npm's MCAP readers, Foxglove's own, read the same from a recording as Python's; needs node and npm."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from benchmarks.results import save

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
LONG = (FieldDescriptor.CPPTYPE_INT64, FieldDescriptor.CPPTYPE_UINT64)
"""No numbers in JavaScript; left out of the sums."""

INSTALLED = ROOT / "build" / "readers"


def by_npm(recording: Path) -> dict[str, Any]:
    """Topics with their messages, metadata and attachments, as npm's readers find them."""
    INSTALLED.mkdir(parents=True, exist_ok=True)
    for name in ("package.json", "read.mjs"):
        (INSTALLED / name).write_bytes((HERE / name).read_bytes())
    subprocess.run(["npm", "install", "--silent", "--no-package-lock"], cwd=INSTALLED, check=True)
    done = subprocess.run(
        ["node", "read.mjs", str(recording)], cwd=INSTALLED, check=True, stdout=subprocess.PIPE, text=True
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def by_python(recording: Path) -> dict[str, Any]:
    """The same, as Python's find them."""
    topics: dict[str, dict[str, Any]] = {}
    with recording.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, _, decoded in reader.iter_decoded_messages():
            assert schema is not None
            topic = topics.setdefault(channel.topic, {"schema": schema.name, "messages": 0, "sum": 0.0})
            topic["messages"] += 1
            fields = ((field.cpp_type not in LONG, value) for field, value in decoded.ListFields())
            topic["sum"] += sum(
                v for short, v in fields if short and type(v) in (int, float) and math.isfinite(v)
            )
        metadata = [[record.name, record.metadata] for record in reader.iter_metadata()]
        attachments = [[record.name, len(record.data)] for record in reader.iter_attachments()]
    return {"topics": topics, "metadata": metadata, "attachments": attachments}


def equal(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether both found the same; sums of numbers to the last digits."""
    if one.keys() != other.keys() or any(one[key] != other[key] for key in ("metadata", "attachments")):
        return False
    if one["topics"].keys() != other["topics"].keys():
        return False
    pairs = [(topic, other["topics"][name]) for name, topic in one["topics"].items()]
    return all(
        a["schema"] == b["schema"]
        and a["messages"] == b["messages"]
        and math.isclose(a["sum"], b["sum"], rel_tol=1e-9)
        for a, b in pairs
    )


def main(quick: bool = False) -> None:
    """Record two trials, read them with both, compare, save."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "run.py", "run", "mock/transient", "--only", "1", "--only", "2"]
        subprocess.run(
            [*command, "--no-report", "--out", folder], cwd=ROOT, check=True, stdout=subprocess.DEVNULL
        )
        (recording,) = Path(folder).glob("*/recording.mcap")
        npm, python = by_npm(recording), by_python(recording)
    same = equal(npm, python)
    versions = json.loads((HERE / "package.json").read_text(encoding="utf-8"))["dependencies"]
    counts = {name: topic["messages"] for name, topic in npm["topics"].items()}
    result = {"npm": versions, "same": same, "messages": counts, "attachments": npm["attachments"]}
    save("readers", result, quick=quick)
