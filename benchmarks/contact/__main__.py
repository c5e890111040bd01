"""`python -m benchmarks.contact [--quick]`."""

import sys

from benchmarks.contact.run import main

if __name__ == "__main__":
    main(quick="--quick" in sys.argv[1:])
