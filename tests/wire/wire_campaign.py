"""A trial of an emulated profile, run as a campaign is, with a hand on the bench."""

from pathlib import Path
from typing import Any

from config.assemble import build_rig, plan_campaign
from controller.campaign import Campaign, Outcome
from controller.console import Console

QUICK = {"behavior.settle_s": "1.0"}


class Hand(Console):
    """Does something to the bench when a trial enters a state; shows nothing."""

    def __init__(self, deeds: dict[str, Any]) -> None:
        super().__init__()
        self.deeds = deeds
        self.seen: list[str] = []

    def state(self, name: str, t_s: float) -> None:
        self.seen.append(name)
        deed = self.deeds.pop(name, None)
        if deed is not None:
            deed()


def run(
    profile: Any, emulator: Any, out: Path, deeds: dict[str, Any] | None = None, number: int = 2
) -> tuple[Outcome, Hand]:
    hand = Hand(deeds or {})
    trials = [trial for trial in profile.trials(1) if trial.id == number]
    rig = build_rig(profile, emulator.endpoints)
    try:
        return Campaign(plan_campaign(profile, trials, 1), rig, hand, out).run(), hand
    finally:
        rig.close()
