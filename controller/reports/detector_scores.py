"""How every detector did on the same approaches, whether it stopped them or only observed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from controller.measures.truth import not_before
from controller.recording.reader import Run
from controller.reports.approaches import ApproachedTrial, Mean, mean_of


@dataclass(frozen=True, slots=True)
class DetectorScore:
    """One detector over all approaches in which it ran.

    Attributes:
        name: Of the detector.
        n: How many approaches.
        true: Contacts after the touch.
        false: Contacts before it.
        silent: Approaches that ended, stopped by another detector or at the limit, before it detected anything.
        delay_s: From onset, over the true ones.
    """

    name: str
    n: int
    true: int
    false: int
    silent: int
    delay_s: Mean


def score_detectors(approaches: Sequence[ApproachedTrial]) -> list[DetectorScore]:
    """First contact of each detector in each approach, against the truth where it is simulated, else the onset."""
    runs = {id(approach.run): approach.run for approach in approaches}
    detected = {key: first_contacts(run) for key, run in runs.items()}
    listening = {key: _listeners(run) for key, run in runs.items()}
    scores = []
    for name in sorted(set().union(*listening.values())):
        members = [each for each in approaches if name in listening[id(each.run)]]
        false, delays, silent = 0, [], 0
        for each in members:
            t_s = detected[id(each.run)].get((each.trial, name))
            touch_s = each.onset_s if each.truth_contact_s is None else each.truth_contact_s
            if t_s is None:
                silent += 1
            elif touch_s is None or not not_before(t_s, touch_s):
                false += 1
            else:
                delays.append(None if each.onset_s is None else t_s - each.onset_s)
        scores.append(DetectorScore(name, len(members), len(delays), false, silent, mean_of(delays)))
    return scores


def first_contacts(run: Run) -> Mapping[tuple[int, str], float]:
    """Bench time of each detector's first contact in each approach, by trial and detector."""
    first: dict[tuple[int, str], float] = {}
    for event in run.events:
        if event.get("event") == "Contact" and event.get("state") == "APPROACH":
            first.setdefault((int(event["trial"]), str(event.get("detector"))), float(event["t_s"]))
    return first


def _listeners(run: Run) -> frozenset[str]:
    return frozenset(
        str(event.get("detector"))
        for event in run.events
        if event.get("event") in ("BaselineReady", "Contact")
    )
