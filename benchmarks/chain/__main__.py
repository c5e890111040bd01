"""`python -m benchmarks.chain [--quick]`."""

import sys

from benchmarks.chain.run import main

main(quick="--quick" in sys.argv[1:])
