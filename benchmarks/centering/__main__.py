"""`python -m benchmarks.centering [--quick]`."""

import sys

from benchmarks.centering.run import main

if __name__ == "__main__":
    main(quick="--quick" in sys.argv[1:])
