"""`python -m benchmarks.physics [--quick]`."""

import sys

from benchmarks.physics.run import main

main("--quick" in sys.argv)
