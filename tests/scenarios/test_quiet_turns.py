"""Turns that are taken together see what they would have seen one by one."""

from dataclasses import replace

import pytest

from config import assemble
from config.jobs import Silent
from config.profile import load_profile
from controller.campaign import Campaign
from controller.loop import Loop
from tests.scenarios.conftest import SHORTER


def ran(name, folder, *, together):
    profile = load_profile(name, SHORTER.get(name, {}))
    rig = assemble.build_rig(profile)
    if not together:
        rig = replace(rig, ahead=None)
    plan = assemble.plan_campaign(profile, profile.trials(1)[:1], 1)
    found = Campaign(plan, rig, Silent(), folder).run().folder
    return [(found / file).read_bytes() for file in ("trials.csv", "events.jsonl")]


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("mock/transient", 3),
        ("mock/flexion", 1.5),  # its behavior moves the tendon ten times a second
        ("mock/pretouch", 3),
        ("mock/centering", 3),
    ],
)
def test_rows_and_events_are_the_same_to_the_byte(name, times, tmp_path, monkeypatch):
    turn, turned = Loop._turn, []
    monkeypatch.setattr(Loop, "_turn", lambda loop, *now: turned.append(1) or turn(loop, *now))
    together = ran(name, tmp_path / "together", together=True)
    few = len(turned)
    assert ran(name, tmp_path / "apart", together=False) == together
    assert few < (len(turned) - few) / times, "most turns were taken together"


def test_what_is_looked_at_at_once_is_not_cut_where_a_stream_could_fall_silent(tmp_path, monkeypatch):
    """With nothing to fear from a device, 4,000 turns of a trial are some 60 looks."""
    looked, look = [], Loop._look
    monkeypatch.setattr(Loop, "_look", lambda loop: looked.append(1) or look(loop))
    ran("mock/pretouch", tmp_path, together=True)
    assert len(looked) < 120
