"""`python -m benchmarks.pretouch [--quick]`."""

import sys

from benchmarks.pretouch.run import main

if __name__ == "__main__":
    main(quick="--quick" in sys.argv[1:])
