"""`python -m benchmarks.aura [--quick]`."""

import sys

from benchmarks.aura.run import main

main(quick="--quick" in sys.argv[1:])
