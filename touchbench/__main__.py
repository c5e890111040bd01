"""The command `touchbench`, also as `python -m touchbench`."""

import sys

from touchbench.lookup import ROOMS, check_own


def main() -> None:
    """Run the command line, if its modules are the program's own."""
    try:
        check_own("run", *ROOMS)
    except ImportError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(2)
    from drivers.core.errors import PROGRAM
    from run import cli

    cli(prog_name=PROGRAM)


if __name__ == "__main__":
    main()
