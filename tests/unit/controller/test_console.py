"""How the person at the bench interrupts, and what they see."""

import io
import math
import os
import pty
import re
import select
import signal
import threading
import time
from decimal import Decimal
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rich.console import Console as Terminal
from rich.text import Text

from behaviors.events import Approached, Forecast
from controller import console as console_module
from controller import live
from controller.campaign import foremost
from controller.console import RESULTS, Console, ConsoleOperator, PlainConsole, key_results
from controller.limits import GuardSettings
from controller.live import LiveConsole
from controller.live_view import LiveView
from controller.recording.series import TrialRecording
from controller.registry import EXPERIMENTS
from controller.scales import DIGITS, figure
from drivers.core import compiled, compiling
from tests.stub_run import Asker

ROW = {"delay_s": 0.21, "extent_m": 0.001, "force_n": 0.05, "truth_contact_s": 1.0, "detect_s": 2.5}

ASKED = "hang 0.50 N on bridge Fx, then press Enter"

PATIENCE_S = 100.0
"""Longest wait for a key on a machine that is busy with other things; it comes within a millisecond otherwise."""


class Keyboard:
    """A terminal whose Enter key the test presses."""

    def __init__(self):
        self.hand, descriptor = pty.openpty()
        self.file = os.fdopen(descriptor, "r")

    def press(self, keys=b"\n"):
        """Keys up to the end of a line, or of the input; the kernel hands them on when it gets to it."""
        os.write(self.hand, keys)
        assert select.select([self.file], [], [], PATIENCE_S)[0]


@pytest.fixture
def keyboard():
    keyboard = Keyboard()
    yield keyboard
    keyboard.file.close()


def interrupt(number=signal.SIGINT):
    signal.raise_signal(number)


ACTS = {
    "Ctrl+C": lambda keyboard, asker: interrupt(),
    "Enter": lambda keyboard, asker: keyboard.press(),
    "no": lambda keyboard, asker: keyboard.press(b"n\n"),
    "blank": lambda keyboard, asker: keyboard.press(b" \n"),
    "oops": lambda keyboard, asker: keyboard.press(b"oops\n"),
    "end of input": lambda keyboard, asker: keyboard.press(b"\x04"),
    "asked": lambda keyboard, asker: asker.ask(2 if asker.question else 1, ASKED),
}
"""What happens at a terminal; any other step is what the operator then requests of the loop."""

SCENES = {
    "Ctrl+C pauses and Enter resumes": [None, "Ctrl+C", "pause", None, "Enter", "resume", None],
    "a word resumes nothing": ["Ctrl+C", "pause", "oops", None, "no", None, "Enter", "resume"],
    "a second Ctrl+C aborts": ["Ctrl+C", "pause", "Ctrl+C", "abort", "abort"],
    "two Ctrl+C before the loop looks abort": ["Ctrl+C", "Ctrl+C", "abort"],
    "an Enter from before the pause resumes nothing": ["Enter", "Ctrl+C", "pause", None],
    "Enter without a pause does nothing": ["Enter", None],
    "a terminal that is gone while paused aborts": ["Ctrl+C", "pause", "end of input", None, "abort"],
    "kill aborts": ["SIGTERM", "abort"],
    "a closed terminal aborts": ["SIGHUP", "abort"],
    "Ctrl+backslash aborts": ["SIGQUIT", "abort"],
    "reading in the background suspends nothing": ["SIGTTIN", None],
    "writing in the background suspends nothing": ["SIGTTOU", None],
    "Enter answers": ["asked", None, "Enter", None, (1, True)],
    "n says no": ["asked", None, "no", None, (1, False)],
    "a blank is no other answer than Enter": ["asked", None, "blank", None, (1, True)],
    "an Enter from before the question answers nothing": ["Enter", "asked", None, None],
    "nor does one from before the same question once more": ["asked", None, "asked", "Enter", None, None],
    "other text than no answers nothing": ["asked", None, "oops", None, "Enter", None, (1, True)],
    "while paused Enter goes on and answers nothing": [
        *("asked", None, "Ctrl+C", "pause", "Enter", "resume"),
        *("Enter", None, (1, True)),
    ],
}


@pytest.mark.parametrize("steps", SCENES.values(), ids=SCENES)
def test_what_is_pressed_at_a_terminal_is_what_the_loop_gets(keyboard, steps):
    asker = Asker()
    with ConsoleOperator(keyboard.file, asking=[asker]) as operator:
        for number, step in enumerate(steps):
            if step in ACTS:
                ACTS[step](keyboard, asker)
            elif str(step).startswith("SIG"):
                interrupt(getattr(signal, step))
            elif not isinstance(step, tuple):
                assert operator.poll() == step, f"step {number}"
    assert asker.answers == [step for step in steps if isinstance(step, tuple)]


def test_without_a_terminal_ctrl_c_aborts_no_file_answers_and_continuing_the_program_resumes(stopper):
    asker = Asker()
    asker.ask(1, ASKED)
    with Path(os.devnull).open() as nothing, ConsoleOperator(nothing, asking=[asker]) as operator:
        assert [operator.poll(), operator.poll()] == [None, None]
        interrupt()
        assert operator.poll() == "abort"
    assert asker.answers == []
    with Path(os.devnull).open() as nothing, ConsoleOperator(nothing) as operator:
        interrupt(signal.SIGTSTP)
        assert operator.poll() == "suspend"
        operator.suspend()
        assert [operator.poll(), operator.poll()] == ["resume", None]


class Stopper:
    """In place of being stopped: what the program would be stopped by, and whether the terminal echoed by then."""

    def __init__(self):
        self.terminal = None
        self.signals = []

    def __call__(self, thread, number):
        import termios

        echoes = self.terminal and bool(termios.tcgetattr(self.terminal)[3] & termios.ECHO)
        self.signals.append((number, echoes))


@pytest.fixture
def stopper(monkeypatch):
    stopper = Stopper()
    monkeypatch.setattr(signal, "pthread_kill", stopper)
    return stopper


def test_ctrl_z_requests_to_suspend_and_leaves_a_pause_that_enter_ends(keyboard, stopper):
    stopper.terminal = keyboard.file.fileno()
    with ConsoleOperator(keyboard.file) as operator:
        interrupt(signal.SIGTSTP)
        assert [operator.poll(), operator.poll()] == ["suspend", None]
        assert stopper.signals == [], "the loop decides when"
        keyboard.press()
        operator.suspend()
        assert stopper.signals == [(signal.SIGSTOP, True)], "the shell finds the terminal as it was"
        assert operator.poll() is None, "an Enter from before does not resume"
        keyboard.press()
        assert [operator.poll(), operator.poll()] == ["resume", None]


def test_in_the_background_the_keyboard_is_not_read(keyboard, monkeypatch):
    monkeypatch.setattr(os, "tcgetpgrp", lambda descriptor: os.getpgrp() + 1)
    with ConsoleOperator(keyboard.file) as operator:
        interrupt()
        assert operator.poll() == "pause"
        keyboard.press()
        assert operator.poll() is None
        monkeypatch.setattr(os, "tcgetpgrp", lambda descriptor: os.getpgrp())
        assert operator.poll() == "resume"


def test_handlers_and_the_terminal_are_as_before_afterwards_and_ctrl_s_holds_no_output_up(keyboard):
    import termios

    def handlers():
        return [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]

    before, modes = handlers(), termios.tcgetattr(keyboard.file.fileno())
    with ConsoleOperator(keyboard.file):
        assert signal.getsignal(signal.SIGINT) is not before[0]
        assert not termios.tcgetattr(keyboard.file.fileno())[3] & termios.ECHO
        assert not termios.tcgetattr(keyboard.file.fileno())[0] & termios.IXON
        keyboard.press(b"\x13\n")
        assert select.select([], [keyboard.file], [], 0.0)[1], "a write would wait for Ctrl+Q"
    assert handlers() == before
    assert termios.tcgetattr(keyboard.file.fileno()) == modes


@pytest.fixture
def plain(keyboard):
    """A plain console, and the lines that it has printed."""
    lines = []
    return PlainConsole(ConsoleOperator(keyboard.file), lines.append), lines


def test_a_question_is_printed_once_on_a_plain_console_and_stands_in_the_live_view(keyboard, screen):
    asker = Asker()
    operator, lines = ConsoleOperator(keyboard.file, asking=[asker]), []
    plain = PlainConsole(operator, lines.append)
    screen._operator = operator
    screen.campaign_started("mock/weights", 3, Path("runs/x"))
    screen.trial_started(1, {"bridge": "x"})
    assert screen.text()[-1] == "Ctrl+C pauses"
    asker.ask(1, ASKED)
    plain.poll()
    plain.poll()
    plain.campaign_ended("")
    assert lines == [ASKED]
    assert screen.text()[-1] == ASKED
    screen.campaign_ended("")


def test_off_a_terminal_each_trial_is_one_line_and_a_pause_is_told_with_the_way_out(plain):
    console, lines = plain
    console.campaign_started("mock/transient", 2, Path("runs/x"))
    console.trial_started(7, {"location": "f", "speed_m_s": 0.004843})
    console.state("APPROACH", 92.0)
    console.trial_ended(7, "false_contact", ROW)
    console.state("PAUSED", 3.0)
    console.campaign_ended("contact: 2")
    assert lines == [
        "mock/transient: 2 trials into runs/x",
        "[1/2] trial 7 location f, speed 4.843 mm/s: false contact, delay 0.21 s, extent 1 mm, force 0.05 N",
        "paused: nothing moves, all is watched; Enter goes on, Ctrl+C aborts",
    ]


def test_off_a_terminal_a_long_campaign_has_a_screen_of_lines_and_one_for_each_trial_that_broke_off(plain):
    console, lines = plain
    console.campaign_started("mock/transient", 132, Path("runs/x"))
    for trial in range(1, 133):
        console.trial_started(trial, {})
        console.trial_ended(trial, "fault" if trial == 7 else "contact", {})
    console.campaign_ended("")
    assert [int(line[1:].partition("/")[0]) for line in lines[1:]] == [1, 6, 7, *range(12, 133, 6)]


def test_a_reader_that_takes_nothing_holds_neither_a_line_nor_the_end_up(keyboard, monkeypatch):
    monkeypatch.setattr(console_module, "LAST_S", 0.05)
    printed, taking = [], threading.Event()

    def show(line):
        taking.wait(60.0)
        printed.append(line)

    console = PlainConsole(ConsoleOperator(keyboard.file), show)
    console.campaign_started("mock/transient", 1, Path("runs/x"))
    console.state("PAUSED", 3.0)
    console.campaign_ended("")
    assert printed == [], "all of them came back while the first one hung"
    taking.set()
    console._printer._thread.join(10.0)
    assert [line.partition(":")[0] for line in printed] == ["mock/transient", "paused"]


def test_off_a_terminal_an_approach_has_a_line_before_and_after_where_its_trial_has_one(plain):
    console, lines = plain
    foreseen = Forecast(0.1, "stage", 0.004, 0.0003, None, 1.5)
    console.campaign_started("mock/transient", 100, Path("runs/x"))
    for trial in (1, 2):
        events = []
        console.trial_started(trial, {})
        behavior, limits = SimpleNamespace(deciding=()), GuardSettings(travel_m=0.012)
        console.watch(LiveView(TrialRecording(1), {}, limits, behavior, events, {}, float))
        console.state("BASELINE", 0.0)
        events.append(foreseen)
        console.state("APPROACH", 0.1)
        events.append(Approached(0.9, "stage", 0.0002, 0.15))
        console.state("HOLDING", 0.9)
        console.state("RETRACTING", 1.0)
        console.trial_ended(trial, "contact", {})
    console.campaign_ended("")
    assert lines[1:] == [
        "stage: forecast, speed 4 mm/s, travel 0.3 mm, most 1.5 N",
        "stage: approached, travel 0.2 mm, pressed 0.15 N",
        "[1/100] trial 1 : contact",
    ]


def test_a_reader_that_has_left_ends_the_output_and_nothing_else(keyboard):
    printed = []

    def show(line):
        printed.append(line)
        raise BrokenPipeError(32, "Broken pipe")

    console = PlainConsole(ConsoleOperator(keyboard.file), show)
    for trial in (1, 2):
        console.campaign_started("mock/transient", trial, Path("runs/x"))
    console.campaign_ended("")
    assert len(printed) == 1


def test_the_key_results_come_first_and_every_measure_names_columns_of_its_own():
    measured = {"truth_s": 1.0, "onset_s": 2.0, "delay_s": 3.0, "force_n": 4.0}
    row = foremost(measured, ["force_n", "delay_s", "seen"])
    assert list(key_results(row)) == ["force_n", "delay_s", "truth_s"]
    assert list(key_results({"a": 1, "b": 2})) == ["a", "b"]
    for name in EXPERIMENTS.keys() - {"grasp"}:
        measures = import_module(EXPERIMENTS[name].measures)
        assert len(measures.HIGHLIGHTS) == RESULTS
        assert set(measures.HIGHLIGHTS) <= set(measures.COLUMNS), name
        assert all(measures.COLUMNS.values()), name


def test_what_was_not_seen_is_a_dash_and_tens_of_kilohertz_have_no_exponent():
    assert (figure(None), figure(0.123456), figure(3), figure("f")) == ("–", "0.1235", "3", "f")
    assert (figure(40000.0), figure(39188.4), figure(-39188.4)) == ("40000", "39188", "−39188")


@given(value=st.floats(), width=st.integers(7, 14))
@example(value=6.32310e-05, width=8)
@example(value=-2.2250738585072014e-308, width=7)
@example(value=99999.5, width=7)
def test_any_number_fits_its_width_and_reads_back_within_the_digits_that_are_shown(value, width):
    text = figure(value, width).replace("−", "-")
    assert len(text) <= width
    if not math.isfinite(value):
        assert text == ("–" if math.isnan(value) else str(value))
        return
    digits = len(re.sub(r"e.*|[-.]", "", text).lstrip("0"))
    places = -Decimal(text).as_tuple().exponent
    assert abs(Decimal(text) - Decimal(value)) <= Decimal(5).scaleb(-places - 1)
    assert digits <= DIGITS or 1e4 <= abs(value) < 1e6
    wider = figure(value).replace("−", "-")
    assert text == wider or len(wider) > width, "no digit is given away that there was room for"


# --- on a terminal -----------------------------------------------------------------------------------


@pytest.fixture
def screen(keyboard, monkeypatch):
    """A live view on a terminal of 80 characters, drawn whenever the loop polls; `text()` is what it shows last.

    `drawn(text)` waits for its thread until the text is on the terminal.
    """
    monkeypatch.setattr(live, "REFRESH_S", -1.0)
    file = io.StringIO()
    terminal = Terminal(file=file, force_terminal=True, width=80, height=24)
    console = LiveConsole(ConsoleOperator(keyboard.file), terminal)

    def text():
        return console._picture().plain.splitlines()

    def drawn(text):
        end_s = time.monotonic() + 60.0
        while text not in file.getvalue():
            assert time.monotonic() < end_s, f"{text} never came: {file.getvalue()}"
            time.sleep(0.005)
        return True

    vars(console).update(text=text, file=file, drawn=drawn)
    return console


def test_the_view_shows_trial_state_results_and_counts(screen):
    screen.campaign_started("mock/transient", 42, Path("runs/x"))
    for trial in range(1, 12):
        screen.trial_started(trial, {"location": "f", "speed_m_s": 0.004843})
        screen.trial_ended(trial, "false_contact" if trial == 3 else "contact", ROW)
    screen.trial_started(12, {"location": "a", "speed_m_s": 0.003785})
    screen.state("APPROACH", 92.25)
    assert screen.poll() is None
    lines = screen.text()
    assert lines[0] == "mock/transient  runs/x"
    assert "11 of 42 trials" in lines[1]
    assert " ".join(lines[3].split()) == "trial location speed, mm/s outcome delay, s extent, mm force, N"
    assert [line.split()[0] for line in lines[4:12]] == [str(trial) for trial in range(4, 12)]
    assert lines[13].startswith("trial 12  APPROACH since 92.25 s, for 0 s  location a  speed 3.785 mm/s")
    assert lines[14] == "contact: 10, false contact: 1; 10 of 11 succeeded"
    assert lines[15] == "Ctrl+C pauses"
    screen.state("PAUSED", 93.0)
    assert screen.text()[-1] == "paused: nothing moves, all is watched. Enter goes on, Ctrl+C aborts"
    screen.campaign_ended("11 trials")
    assert screen.text()[-1].startswith("   11"), "what is left is the table; the line of the outcome follows"


def test_the_table_shows_every_number_and_text_whole(screen):
    screen.campaign_started("mock/slip", 2, Path("runs/x"))
    screen.trial_started(1, {"sensor": "barrett_finger", "speed_m_s": -6.3231e-05})
    screen.trial_ended(1, "false_contact", {"delay_s": None, "extent_m": -1.2345e-100, "force_n": 6.3231e-05})
    head, row = screen.text()[3:5]
    assert row.split() == ["1", "barrett_finger", "−0.06323", "false", "contact", "–", "−1.2e−97"]
    assert "force" not in head, "what there is no room for is left out whole"
    assert len(head) == len(row), "names stand above their columns"
    screen.campaign_ended("")


def test_a_new_state_is_not_drawn_before_its_commands_are_out(screen):
    screen.campaign_started("mock/transient", 42, Path("runs/x"))
    screen.trial_started(1, {})
    screen.poll()
    assert screen.drawn("trial 1")
    screen.state("STOPPING", 3.0)
    assert screen._drawer._pictures.empty()
    assert "STOPPING" not in screen.file.getvalue()
    screen.poll()
    assert screen.drawn("STOPPING")
    screen.campaign_ended("")


def test_a_pause_counts_in_no_time_that_is_left_within_a_trial_or_before_the_next(monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(console_module, "monotonic_s", lambda: now_s[0])
    console = Console()
    console.campaign_started("mock/transient", 3, Path("runs/x"))
    console.trial_started(1, {})
    assert console.left_s is None
    now_s[0] = 10.0
    console.trial_ended(1, "contact", {})
    console.state("PAUSED", 0.0)
    now_s[0] = 100.0
    assert console.left_s == pytest.approx(20.0)
    console.trial_started(2, {})
    now_s[0] = 105.0
    assert console.left_s == pytest.approx(30.0)


def test_the_last_picture_is_on_the_terminal_when_the_campaign_has_ended(screen):
    screen.campaign_ended("stage: no such port")
    assert screen.file.getvalue() == "", "a campaign that never began has none"
    screen.campaign_started("mock/transient", 1, Path("runs/x"))
    screen.trial_started(1, {})
    screen.trial_ended(1, "contact", ROW)
    screen.campaign_ended("1 trial")
    assert "1 of 1 trials" in screen.file.getvalue()


def test_ctrl_c_is_answered_while_the_loop_compiles_and_the_second_ends_that(monkeypatch, keyboard):
    """The loop hands over no picture and polls nothing meanwhile."""
    with ConsoleOperator(keyboard.file) as operator:
        output = io.StringIO()
        drawer = live.Drawer(Terminal(file=output, force_terminal=True, width=200), operator.pressed_yet)
        for line in ("Ctrl+C again ends the run", "the run ends as soon as"):
            assert not compiled.interrupted()
            signal.raise_signal(signal.SIGINT)
            by_s = time.monotonic() + PATIENCE_S
            while line not in output.getvalue():
                assert time.monotonic() < by_s, output.getvalue()
                time.sleep(0.01)
        assert compiled.interrupted()
        with pytest.raises(KeyboardInterrupt):
            compiling._progress.begin(None)
        drawer.end(Text())
    assert not compiled.interrupted()
