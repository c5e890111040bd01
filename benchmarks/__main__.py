"""All benchmarks, one after the other: `make bench`, or by name: `python -m benchmarks loop stop`."""

import sys
from importlib import import_module

STUDIES = "physics grasp slip slip_thresholds pretouch pretouch_rooms centering contact onset curves costs"
MODULES = {"stop": "stop_latency"}
BENCHMARKS = ("loop", "stop", "left_alone", *STUDIES.split())


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
        import_module(f"benchmarks.{MODULES.get(name, name)}").main(quick=quick)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
