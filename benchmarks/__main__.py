"""All benchmarks, one after the other: `make bench`, or by name: `python -m benchmarks loop stop`."""

import sys
from importlib import import_module

BENCHMARKS = {
    "loop": "benchmarks.loop",
    "stop": "benchmarks.stop_latency",
    "page": "benchmarks.live_page",
    "watched_run": "benchmarks.watched_run",
    "readers": "benchmarks.readers",
    "left_alone": "benchmarks.left_alone",
    "physics": "benchmarks.physics.run",
    "chain": "benchmarks.chain",
    "slip": "benchmarks.slip.study",
    "slip_thresholds": "benchmarks.slip_thresholds",
    "pretouch": "benchmarks.pretouch.run",
    "pretouch_rooms": "benchmarks.pretouch.rooms_study",
    "centering": "benchmarks.centering.run",
    "centering_rooms": "benchmarks.centering.rooms",
    "contact": "benchmarks.contact.run",
    "campaigns": "benchmarks.campaigns",
    "costs": "benchmarks.costs",
}


def main(names: list[str]) -> int:
    """Run the named benchmarks, or all; --quick makes each a minute at most."""
    quick = "--quick" in names
    chosen = [name for name in names if name != "--quick"] or list(BENCHMARKS)
    unknown = sorted(set(chosen) - set(BENCHMARKS))
    if unknown:
        print(f"no benchmark {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}", file=sys.stderr)
        return 2
    for name in chosen:
        print(f"=== {name}", flush=True)
        import_module(BENCHMARKS[name]).main(quick=quick)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
