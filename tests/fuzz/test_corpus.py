"""What the fuzzer found to reach far into each decoder, whole and broken, once more."""

import random
import tracemalloc
from pathlib import Path

import pytest

from tests.fuzz.targets import BYTES_MAX, TARGETS

CORPUS = Path(__file__).resolve().parent / "corpus"

MEMORY_BYTES = 64 << 20
"""For one input of some kilobytes; a recording unpacks no chunk that is larger."""


@pytest.mark.parametrize("name", TARGETS)
def test_only_a_decoders_own_error_comes_out_of_any_bytes_in_bounded_memory(name: str) -> None:
    target = TARGETS[name]
    whole = [*target.seeds(), *(path.read_bytes() for path in sorted((CORPUS / name).glob("*")))]
    changes = random.Random(name)
    broken = [_broken(data, changes) for data in whole]
    tracemalloc.start()
    try:
        for data in (*whole, *broken):
            tracemalloc.reset_peak()
            held, _ = tracemalloc.get_traced_memory()
            target.run(data)
            assert tracemalloc.get_traced_memory()[1] - held < MEMORY_BYTES, data[:200]
    finally:
        tracemalloc.stop()


def _broken(data: bytes, changes: random.Random) -> bytes:
    """A bit turned, and the end cut off."""
    turned = bytearray(data or b"\0")
    turned[changes.randrange(len(turned))] ^= 1 << changes.randrange(8)
    return bytes(turned[: changes.randrange(len(turned) // 2, min(len(turned), BYTES_MAX) + 1)])
