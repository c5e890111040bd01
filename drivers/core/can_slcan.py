"""python-can's slcan, without waiting."""

import os

from can.exceptions import CanOperationError
from can.interfaces.slcan import slcanBus


class PromptSlcan(slcanBus):
    """A slcan adapter whose lines are handed to the kernel at once, or not at all.

    python-can's own `_write` waits for a port that is full, and then until the last bit has left the host (2.3 ms a
    frame at 115,200 baud).
    """

    def _write(self, string: str) -> None:
        line = string.encode() + self.LINE_TERMINATOR
        try:
            taken = os.write(self.serialPortOrig.fileno(), line)  # pyserial opens without blocking
        except BlockingIOError:
            taken = 0
        except (OSError, TypeError) as error:  # TypeError: the port was closed meanwhile
            raise CanOperationError(f"Could not write to serial device: {error}") from error
        if taken < len(line):
            raise CanOperationError("the adapter takes no more bytes")
