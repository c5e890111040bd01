"""A pty whose far end is the test, and patience with threads that read it."""

import os
import time
import tty
from collections.abc import Callable


class OpenEnd:
    def __init__(self) -> None:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.path = os.ttyname(self.slave)

    def send(self, data: bytes) -> None:
        os.write(self.master, data)

    def hang_up(self) -> None:
        for descriptor in (self.master, self.slave):
            if descriptor >= 0:
                os.close(descriptor)
        self.master = self.slave = -1


def eventually(condition: Callable[[], bool]) -> bool:
    """Whether it came true within a minute: a busy machine's threads may be that late."""
    until_s = time.monotonic() + 60.0
    while not condition() and time.monotonic() < until_s:
        time.sleep(0.001)
    return condition()
