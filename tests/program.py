"""The program as a process of its own, and on a terminal with a person at it."""

import contextlib
import os
import pty
import re
import select
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

PATIENCE_S = 200.0
"""For a busy machine to start Python, run trials and draw a report: thirty times what an idle one takes."""


Verb = Callable[..., tuple[int, str, str]]
"""As the fixture `verb` calls the program in this process; gives exit code, output and errors."""


def program(*arguments, **how):
    """`run.py` with these arguments."""
    command = [sys.executable, "run.py", *map(str, arguments)]
    return subprocess.Popen(command, cwd=ROOT, text=True, **how)


@contextlib.contextmanager
def started(*arguments, **how):
    """The same; it is gone afterwards."""
    process = program(*arguments, **how)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


class Terminal:
    """A program on a terminal of its own, and the person at it."""

    def __init__(self, arguments):
        self.seen = self._all = ""
        self.pid, self.descriptor = pty.fork()
        if self.pid == 0:
            os.chdir(ROOT)
            os.environ.update(TERM="xterm", COLUMNS="100", LINES="40")
            os.execv(sys.executable, [sys.executable, "run.py", *arguments])

    def until(self, text, seconds=100.0):
        """Read until a text has come since the last call; returns what was read, without its colours."""
        end_s = time.monotonic() + seconds
        while text not in self.seen:
            assert time.monotonic() < end_s, f"{text!r} never came, but {self.seen[-600:]!r}"
            self._read(0.1)
        read, _, self.seen = self.seen.partition(text)
        return read

    def press(self, keys):
        os.write(self.descriptor, keys)

    def hold(self, key, text, seconds=0.0):
        """Hold a key, which comes every 40 ms, until a text has come and so much longer."""
        end_s = time.monotonic() + 120.0
        while (now_s := time.monotonic()) < end_s:
            self.press(key)
            self._read(0.04)
            if text in self.seen:
                end_s, text = min(end_s, now_s + seconds), ""
        assert not text, f"{text!r} never came, but {self.seen[-600:]!r}"
        self.seen = ""

    def _read(self, seconds):
        if select.select([self.descriptor], [], [], seconds)[0]:
            data = b""
            with contextlib.suppress(OSError):  # the program has ended
                data = os.read(self.descriptor, 65536)
            assert data, f"it ended: {self._all[-900:]!r}"
            text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", data.decode(errors="replace"))
            self.seen, self._all = self.seen + text, self._all + text

    def hang_up(self):
        """The terminal goes away; returns the exit code of the program."""
        os.close(self.descriptor)
        end_s = time.monotonic() + 120.0
        while time.monotonic() < end_s:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.05)
        os.kill(self.pid, 9)
        os.waitpid(self.pid, 0)
        raise AssertionError("it did not end")

    def kill(self):
        """Kill the program."""
        os.kill(self.pid, 9)
        os.waitpid(self.pid, 0)
        os.close(self.descriptor)

    def close(self):
        """Waits for its end; returns the exit code."""
        end_s = time.monotonic() + 120.0
        while time.monotonic() < end_s:
            if select.select([self.descriptor], [], [], 0.05)[0]:
                with contextlib.suppress(OSError):
                    os.read(self.descriptor, 65536)
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                os.close(self.descriptor)
                return os.waitstatus_to_exitcode(status)
        self.kill()
        raise AssertionError("it did not end")
