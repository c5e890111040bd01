"""A run that is watched is the run that it would have been."""

import os
import socket
from contextlib import closing
from pathlib import Path

from config.assemble import build_rig, plan_campaign
from config.jobs import Silent
from config.profile import load_profile
from controller.campaign import Campaign
from controller.console import ConsoleOperator
from controller.watching.feed import SOCKET, Watched, at
from controller.watching.page import after, trial_signals
from tests.scenarios.conftest import QUICK


def rows(out, watchers):
    """The rows of a run of two trials with so many clients that never read."""
    profile = load_profile("mock/transient", QUICK)
    plan = plan_campaign(profile, profile.trials(0)[:2], 0)
    deaf = [socket.socket(socket.AF_UNIX) for _ in range(watchers)]

    def began(folder):
        for each in deaf:
            with at(folder / SOCKET) as name:
                each.connect(name)

    with Path(os.devnull).open() as keyboard, closing(build_rig(profile)) as rig:
        console = Watched(Silent(), ConsoleOperator(keyboard), began)
        outcome = Campaign(plan, rig, console, out).run()
    for each in deaf:
        each.close()
    assert (outcome.exit_code, outcome.error) == (0, None)
    assert not (outcome.folder / SOCKET).exists()
    assert after(outcome.folder) | {"folder": "", "reason": ""} == {
        "status": "done",
        "code": 0,
        "reason": "",
        "folder": "",
        "report": False,
    }
    signals = trial_signals(outcome.folder, plan.left[0].id)["signals"]
    assert next(iter(signals)).startswith("detector."), "what decides comes first"
    assert all(len(each["t"]) == len(each["y"]) > 1 for each in signals.values())
    return (outcome.folder / "trials.csv").read_bytes()


def test_rows_are_the_same_with_clients_that_do_not_read(tmp_path):
    assert rows(tmp_path / "alone", 0) == rows(tmp_path / "watched", 3)
