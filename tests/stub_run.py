"""A run that can be watched, without a bench: a loop that turns, records and asks its operator."""

import os
import threading
import time
from pathlib import Path

import numpy as np

from behaviors.events import Contact
from behaviors.transient import Transient, TransientFactors, TransientSettings
from controller.console import Console, ConsoleOperator
from controller.limits import GuardSettings
from controller.live_view import LiveView
from controller.recording.series import TrialRecording
from controller.watching.feed import Watched
from drivers.core.messages import SampleBlock
from drivers.core.protocols import Question


class Asker:
    """A device that asks the person."""

    def __init__(self):
        self.question, self.answers = None, []

    def ask(self, number, text):
        self.question = Question(number, text)

    def answer(self, number, done):
        self.answers.append((number, done))
        self.question = None


class Detector:
    name, inputs = "contact", ("board.period",)


class StubRun:
    """One trial that goes on until the operator ends it; `requests` is what the loop received from them, and when."""

    def __init__(self, folder, began=None):
        folder.mkdir()
        self.folder, self.requests, self.turns = folder, [], 0
        self.asker = Asker()
        self.keyboard = Path(os.devnull).open()  # noqa: SIM115 - until the run ends
        self.operator = ConsoleOperator(self.keyboard, asking=[self.asker])
        self.console = Console(self.operator)
        self.watched = Watched(self.console, self.operator, began)
        self.events, self.lost = [Contact(0.5, "contact", 28.31, 28.2)], {"board.load_cell": 3}
        self.recording = TrialRecording(3)
        limits = GuardSettings(force_n=2.0, travel_m=0.012)
        self.t_s = 1.0
        self.console.campaign_started("mock/stub", 42, folder)
        self.console.trial_started(3, {"location": "f", "speed_m_s": 0.003785})
        self.console.watch(
            LiveView(
                self.recording,
                {"contact": Detector()},
                limits,
                Transient(TransientSettings(), TransientFactors(speed_m_s=0.005), frozenset({"contact"})),
                self.events,
                self.lost,
                lambda: self.t_s,
            )
        )
        self.console.trial_ended(2, "contact", {"delay_s": 0.212, "force_n": 0.04})
        self.console.state("APPROACH", 1.0)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        request = None
        while request != "abort":
            request = self.console.poll()
            if request is not None:
                self.requests.append((request, time.monotonic()))
                self.console.state(
                    {"pause": "PAUSED", "resume": "APPROACH"}.get(request, "STOPPING"), self.t_s
                )
            self._record()
            self.turns += 1
            time.sleep(0.005)

    def _record(self):
        """10 ms of samples."""
        first = round(1000.0 * self.t_s)
        self.t_s += 0.01
        times_s = np.arange(first, first + 10) / 1000.0
        for stream, values, unit in (
            ("board.period", 1.0 / (28.0 + 0.1 * np.sin(times_s)), "s"),
            ("board.load_cell", 0.04 + 0.01 * np.cos(times_s), "N"),
            ("stage.position", 0.003 + 1e-4 * times_s, "m"),
        ):
            block = SampleBlock(stream, first, times_s[0], values[:, None], rate_hz=1000.0, unit=unit)
            self.recording.add(block)
        readings = np.column_stack([28.0 + 0.1 * np.sin(times_s[-1:]), [28.2]])
        self.recording.add(
            SampleBlock("detector.contact", first, times_s[-1], readings, times_s=times_s[-1:])
        )

    def ask(self, text):
        self.asker.ask(7, text)

    def received(self):
        return [request for request, _ in self.requests]

    def end(self):
        self.operator.press("stop", "the test")
        self._thread.join(10.0)
        self.console.campaign_ended("interrupted: the bench is still")
        self.keyboard.close()
