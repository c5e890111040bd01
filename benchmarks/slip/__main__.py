"""`python -m benchmarks.slip [--quick]`."""

import sys

from benchmarks.slip.study import main

main(quick="--quick" in sys.argv[1:])
