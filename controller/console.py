"""The person at the bench: how they interrupt a campaign, and what they see of it off a terminal."""

import os
import re
import select
import signal
import sys
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from threading import Thread, get_ident
from types import FrameType, MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TextIO

from controller.outcomes import UNMEASURED
from controller.scales import scale_of
from drivers.core import compiled
from drivers.core.clock import monotonic_s
from drivers.core.protocols import Asking, Question

if TYPE_CHECKING:
    from controller.live_view import LiveView
    from controller.loop import HandOperator
    from controller.watching.feed import Watched

PAUSED = "PAUSED"
"""What the loop calls the state in which it waits for the operator."""

LAST_S = 1.0
"""How long the last lines, or the last picture, may take to come out (assumption: far beyond what a terminal takes that
takes anything)."""

RESULTS = 3
"""How many results of a trial are shown; the others are in its row of trials.csv."""


class ConsoleOperator:
    r"""Ctrl+C, `kill` and the Enter key, as the loop asks for them at every turn.

    On a terminal the first Ctrl+C pauses and the second aborts, while Enter goes on with what is paused.
    Without a terminal Enter cannot be pressed, so the first one aborts, as `kill` and a closed terminal always
    and Ctrl+\ always do. Ctrl+Z pauses as well, and suspends the program once the loop has seen everything stand still;
    when it is continued, it is still paused (without a terminal, where Enter cannot be pressed, it also resumes).
    A signal sets a flag and no more: nothing is interrupted in the middle, the loop stops what moves. In the
    background the keyboard is not read, so that nothing there can suspend a program whose bench moves.

    Where a device asks the person for something, Enter answers it, as long as nothing is paused; what was pressed
    before the question came up is ignored.

    Use as a context manager; the handlers from before are put back at its end.

    Args:
        keyboard: Where Enter is pressed; standard input unless a test gives another.
        asking: Devices that ask the person at this keyboard.
    """

    _single = False  # whether each key comes as it is pressed, and not with the line's Enter

    def __init__(self, keyboard: TextIO | None = None, asking: Iterable[Asking] = ()) -> None:
        self._keyboard = sys.stdin if keyboard is None else keyboard
        self._interactive = self._keyboard is not None and self._keyboard.isatty()
        self._asking = tuple(asking)
        self._put: tuple[Asking, Question] | None = None
        self._before: dict[signal.Signals, Any] = {}
        self._modes: list[Any] | None = None
        self._pause = False
        self._suspend = False
        self._paused = False
        self._go_on = False
        self._abort = False
        self._reply: tuple[int, bool] | None = None
        self.pressed_by = ""

    def __enter__(self) -> Self:
        handlers: dict[signal.Signals, Any] = {
            signal.SIGINT: self._interrupted,
            signal.SIGTERM: lambda *_: self.press("stop", "kill"),
            signal.SIGHUP: lambda *_: self.press("stop", "the closed terminal"),
            signal.SIGQUIT: lambda *_: self.press("stop", "Ctrl+\\ at the terminal"),
            signal.SIGTSTP: lambda *_: self.press("suspend", "Ctrl+Z at the terminal"),
            # from the background into the foreground as well: the shell has set the terminal as it likes it
            signal.SIGCONT: lambda *_: self._silence_keys(),
            # What a terminal sends to a program in the background that reads or writes: it would suspend it at once.
            **dict.fromkeys((signal.SIGTTIN, signal.SIGTTOU), signal.SIG_IGN),
        }
        self._before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
        compiled.interrupted = lambda: self._abort
        self._silence_keys()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        compiled.interrupted = bool
        self._show_keys()

    def poll(self) -> str | None:
        """What the operator wants now: "pause", "suspend", "resume", "abort", or None. Never waits."""
        if self._abort:
            return "abort"
        if self._suspend:
            self._suspend, self._pause, self._paused = False, False, True
            return "suspend"
        if self._go_on:
            self._go_on = self._paused = False
            return "resume"
        if self._pause:
            self._pause, self._paused = False, True
            self._forget_keys()
            return "pause"
        if not self._paused:
            self._read_answer()
        elif self._line_typed() == "":  # Enter alone: a word was meant for something else
            self._paused = False
            return "resume"
        return None

    def suspend(self) -> None:
        """Suspend the program until it is continued; nothing may be moving."""
        self._show_keys()
        # this thread's own signal: it goes no instruction farther
        signal.pthread_kill(get_ident(), signal.SIGSTOP)
        self._silence_keys()
        self._forget_keys()
        self._go_on = not self._interactive

    def press(self, command: str, by: str) -> None:
        """A command from elsewhere, on any thread: "pause", "suspend", "resume" or "stop".

        A stop is latched: the run ends by it, and another act begins the next.

        Args:
            by: Who presses, for those who watch.
        """
        self.pressed_by = by
        # Each flag is only ever set here: one that were read and written back could undo what another thread has set.
        if command == "stop":
            self._abort = True
        elif command == "suspend":
            self._suspend = True
        elif command == "pause" and not self._paused:
            self._pause = True
        elif command == "resume" and self._paused:
            self._go_on = True

    def reply(self, number: int, done: bool) -> None:
        """An answer from elsewhere, on any thread, to the question of that number."""
        self._reply = number, done

    def pressed_yet(self) -> str:
        """What was pressed and is not heeded yet, as a line; on any thread. A loop that computes heeds it at once."""
        if self._abort:
            return "seen: the run ends as soon as what is being computed or compiled is done"
        if self._pause:
            return "seen: pauses as soon as what is being computed or compiled is done; Ctrl+C again ends the run"
        return ""

    @property
    def stopped(self) -> bool:
        """Whether the run was stopped from elsewhere."""
        return self._abort

    @property
    def halted(self) -> bool:
        """Whether somebody has stopped or paused the run, heeded yet or not, and has not let it go on."""
        return self._abort or self._pause or self._suspend or self._paused

    @property
    def question(self) -> Question | None:
        """What a device asks the person now."""
        asked = self._open_question()
        return asked and asked[1]

    def _interrupted(self, number: int, frame: FrameType | None) -> None:
        self.pressed_by = "Ctrl+C at the terminal"
        if self._interactive and not (self._pause or self._paused):
            self._pause = True
        else:
            self._abort = True

    def _silence_keys(self) -> None:
        """Keys that are pressed do not show: they would shift a live view by a line. Nor does Ctrl+S hold output up.

        Nothing is drained: a terminal that takes nothing would be waited for.
        """
        if not self._in_foreground():
            return
        import termios

        with suppress(termios.error):
            modes = termios.tcgetattr(self._keyboard.fileno())
            self._modes = self._modes or modes
            silent = list(modes)
            silent[0] &= ~termios.IXON
            silent[3] &= ~(termios.ECHO | (termios.ICANON if self._single else 0))
            termios.tcsetattr(self._keyboard.fileno(), termios.TCSANOW, silent)

    def _show_keys(self) -> None:
        """The terminal as it was."""
        if self._modes is not None and self._in_foreground():
            import termios

            with suppress(termios.error):
                termios.tcsetattr(self._keyboard.fileno(), termios.TCSANOW, self._modes)

    def _in_foreground(self) -> bool:
        """Whether there is a terminal whose keys are meant for this program."""
        if not self._interactive:
            return False
        try:
            return os.tcgetpgrp(self._keyboard.fileno()) == os.getpgrp()
        except OSError:  # not this session's terminal, so that no shell has its jobs there; or it has hung up
            return True

    def _forget_keys(self) -> None:
        """An Enter from before the pause does not resume."""
        if self._in_foreground():
            import termios

            with suppress(termios.error):
                termios.tcflush(self._keyboard.fileno(), termios.TCIFLUSH)

    def _line_typed(self) -> str | None:
        """What was typed before Enter, or None where Enter was not pressed."""
        typed = self._typed()
        return None if typed is None else typed.strip().lower()

    def _typed(self) -> str | None:
        """What the keyboard has, or None; where it has gone, the run ends."""
        if not self._in_foreground():
            return None
        descriptor = self._keyboard.fileno()
        if not select.select([descriptor], [], [], 0.0)[0]:
            return None
        try:
            typed = os.read(descriptor, 1024)
        except OSError:
            typed = b""
        if not typed:
            self.press("stop", "the closed terminal")  # with it, the only way to resume has gone
            return None
        return typed.decode(errors="replace")

    def _open_question(self) -> tuple[Asking, Question] | None:
        asked = ((device, question) for device in self._asking if (question := device.question) is not None)
        return next(asked, None)

    def _read_answer(self) -> None:
        """Enter answers a question that has been put; any other text than no is a slip of the finger."""
        asked = self._open_question()
        new, self._put = asked != self._put, asked
        reply, self._reply = self._reply, None
        if asked is not None and reply is not None and reply[0] == asked[1].number:
            asked[0].answer(*reply)
            return
        if asked is None or not self._interactive:
            return
        if new:
            self._forget_keys()
            return
        typed = self._line_typed()
        if typed in ("", "n", "no"):
            device, question = asked
            device.answer(question.number, typed == "")


_KEY = re.compile(r"\x1b[\[O][0-9;]*[A-Za-z~]|.", re.DOTALL)


class EndingOperator(ConsoleOperator):
    """The same by hand: Ctrl+C ends instead of pausing, and a program that is continued after Ctrl+Z goes on."""

    def suspend(self) -> None:
        """See `ConsoleOperator.suspend`."""
        super().suspend()
        self._go_on = True

    def _interrupted(self, number: int, frame: FrameType | None) -> None:
        self._abort = True


class KeyOperator(EndingOperator):
    """The same where single keys steer: each is read as it is pressed."""

    _single = True

    def pressed(self) -> Sequence[str]:
        """What was pressed since the last call, in order; an arrow key is its escape sequence."""
        return _KEY.findall(self._typed() or "")


class _Printer:
    """Prints lines on a thread of its own: a reader that takes nothing holds up that thread and no other.

    Args:
        show: Prints a line; where it raises `OSError`, the reader has left, and nothing more is printed.
    """

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._lines: SimpleQueue[str | None] = SimpleQueue()
        # A thread that is held up may outlive the campaign, but not the program.
        self._thread = Thread(target=self._run, name="printer", daemon=True)
        self._thread.start()

    def print(self, line: str) -> None:
        """Hand over a line. Never waits, never raises."""
        self._lines.put(line)

    def end(self) -> None:
        """Print what is left; a reader that takes nothing is waited for no longer than `LAST_S`."""
        self._lines.put(None)
        self._thread.join(LAST_S)

    def _run(self) -> None:
        with suppress(OSError):
            while (line := self._lines.get()) is not None:
                self._show(line)


ROWS = 200
"""So many of the last trials are kept: what a late client of the feed gets."""


class Present(NamedTuple):
    """The trial under way (None between two), its state, and since when, s of bench time; replaced as a whole."""

    trial: int | None = None
    factors: Mapping[str, Any] = MappingProxyType({})
    state: str = ""
    since_s: float = 0.0


class Console:
    """What is known of a campaign under way, for all that show it, and who may interrupt it; this one draws nothing.

    The loop's thread notes, another may read: each attribute is replaced, or grows.

    Args:
        operator: Who may interrupt; None: nobody.
        successes: Outcomes that are success; None where the experiment declares none.

    Attributes:
        feed: Publishes it to those who watch, who may hold it between two trials; None where nobody may.
        count: How many trials there are.
        rows: Of each trial that has ended: number, factors, outcome, what was measured.
        counts: How many trials ended in each outcome.
        ended: The last line, once all is over.
        entered_s: When the present state began, by the wall clock.
    """

    feed: "Watched | None" = None

    def __init__(
        self, operator: "HandOperator | None" = None, successes: Collection[str] | None = None
    ) -> None:
        self._hand = operator
        self.successes = successes
        self.title, self.count, self.folder = "", 0, Path()
        self.present = Present()
        self.view: LiveView | None = None
        self.counts: Counter[str] = Counter()
        self.rows: deque[tuple[int, Mapping[str, Any], str, Mapping[str, Any]]] = deque(maxlen=ROWS)
        self.ended: str | None = None
        self.begun_s = self.entered_s = monotonic_s()
        self._paused_s = 0.0

    def poll(self) -> str | None:
        """See `controller.loop.HandOperator`."""
        return None if self._hand is None else self._hand.poll()

    def suspend(self) -> None:
        """See `controller.loop.HandOperator`."""
        if self._hand is not None:
            self._hand.suspend()

    def campaign_started(self, title: str, trials: int, folder: Path) -> None:
        """Before the first trial; from now on the run can be watched."""
        self.title, self.count, self.folder = title, trials, folder
        self.begun_s = self.entered_s = monotonic_s()
        self._paused_s = 0.0
        if self.feed is not None:
            self.feed.begin(folder)

    def trial_started(self, trial: int, factors: Mapping[str, Any]) -> None:
        """Before each trial."""
        self._enter(Present(trial, dict(factors)))

    def watch(self, view: "LiveView") -> None:
        """After each trial's recording has begun."""
        self.view = view

    def state(self, name: str, t_s: float) -> None:
        """See `controller.loop.LoopOperator`."""
        self._enter(self.present._replace(state=name, since_s=t_s))

    def trial_ended(self, trial: int, outcome: str, row: Mapping[str, Any]) -> None:
        """After each trial."""
        self.rows.append((trial, self.present.factors, outcome, row))
        self.counts[outcome] += 1  # last: who reads this many finds as many rows

    def campaign_ended(self, line: str) -> None:
        """After the last; all who watch are told."""
        self.present, self.ended = self.present._replace(trial=None), line or "done"
        if self.feed is not None:
            self.feed.end()

    def _enter(self, present: Present) -> None:
        now_s = monotonic_s()
        if self.present.state == PAUSED:
            self._paused_s += now_s - self.entered_s
        self.present, self.entered_s = present, now_s

    @property
    def left_s(self) -> float | None:
        """What the other trials will take, by what those took that are done, pauses left out; None before one is."""
        done, now_s = self.counts.total(), monotonic_s()
        present_s = now_s - self.entered_s if self.present.state == PAUSED else 0.0
        ran_s = now_s - self.begun_s - self._paused_s - present_s
        return ran_s / done * (self.count - done) if done else None

    @property
    def said(self) -> Sequence[str]:
        """The trial's factors, as text."""
        return [scale_of(name).said(value) for name, value in self.present.factors.items()]


LINES = 24
"""About so many trials of a campaign have a line off a terminal: as many as one screen has."""


class PlainConsole(Console):
    """A line for each trial and for each of its approaches, of a long campaign for every so many, for files and pipes.

    Args:
        show: Prints a line, on a thread of its own.
        first: Line to begin with; empty for none.
    """

    def __init__(
        self,
        operator: ConsoleOperator,
        show: Callable[[str], None],
        first: str = "",
        successes: Collection[str] | None = None,
    ) -> None:
        super().__init__(operator, successes)
        self._operator = operator
        self._question: Question | None = None
        self._printer = _Printer(show)
        self._print = self._printer.print
        self._first = first
        self._begun = 0
        self._foreseen = ""

    def poll(self) -> str | None:
        """Polls the operator, and prints the question of a device."""
        question = self._operator.question
        if question != self._question:
            self._question = question
            if question is not None:
                self._print(question.text)
        return super().poll()

    def campaign_started(self, title: str, trials: int, folder: Path) -> None:
        """Prints what is run, and where it goes."""
        super().campaign_started(title, trials, folder)
        if self._first:
            self._print(self._first)
        self._print(f"{title}: {trials} trial{'s' * (trials != 1)} into {folder}")

    def trial_started(self, trial: int, factors: Mapping[str, Any]) -> None:
        """Nothing is printed before there is a result."""
        super().trial_started(trial, factors)
        self._begun, self._foreseen = self._begun + 1, ""

    def state(self, name: str, t_s: float) -> None:
        """A line for a pause, and for what an approach will do and has done, where it is this trial's turn."""
        super().state(name, t_s)
        if name == PAUSED:
            self._print("paused: nothing moves, all is watched; Enter goes on, Ctrl+C aborts")
        foreseen = self.view.foreseen() if self.view is not None and self._shown else ""
        if foreseen != self._foreseen:
            self._foreseen = foreseen
            self._print(foreseen)

    def trial_ended(self, trial: int, outcome: str, row: Mapping[str, Any]) -> None:
        """Prints the result, where it is this trial's turn."""
        super().trial_ended(trial, outcome, row)
        if not self._shown and outcome not in UNMEASURED:
            return
        results = ", ".join(scale_of(name).said(value) for name, value in key_results(row).items())
        said = f"{', '.join(self.said)}: {outcome.replace('_', ' ')}, {results}"
        self._print(f"[{self._begun}/{self.count}] trial {trial} {said}".rstrip(", "))

    @property
    def _shown(self) -> bool:
        return self._begun in (1, self.count) or self._begun % -(-self.count // LINES or 1) == 0

    def campaign_ended(self, line: str) -> None:
        """The exit prints the rest."""
        super().campaign_ended(line)
        self._printer.end()


def key_results(row: Mapping[str, Any]) -> dict[str, Any]:
    """The results of a row that are shown, by column: the first ones, as the experiment's measure orders them."""
    return dict(islice(row.items(), RESULTS))
