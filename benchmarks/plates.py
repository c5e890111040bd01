"""What changes where fingers vibrate as plates do: `python -m benchmarks plates`.

Everywhere else a finger sends and receives at a point. Here its pad vibrates in half waves across and along
(`AuraPlantSettings.plate`), as loud from 2.5 cm as the point is; nothing is set anew. Pre-touch in an empty room, at
each detector's threshold for point-like fingers; centering with like fingers, settings of `mock/centering`.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks import centering, pretouch_rooms
from benchmarks.pretouch_rooms import NEEDED_M, OURS, Passing
from benchmarks.results import save
from controller.detectors.pretouch import PreTouchSettings
from simulator.physics.aura import plate_echo
from simulator.physics.aura_settings import SIX, AuraPlantSettings

PLATES = (None, (0, 0), (0, 1), (0, 2), (1, 1), (2, 2), (2, 4))
WAVE_RAD_M = 2.0 * math.pi * centering.DRIVE_HZ / AuraPlantSettings().sound_m_s(293.15)
SEED_PRETOUCH, SEED_CENTERING = 68_000, 69_000
STRENGTHS_DB = (0.0, 17.0)
NAMES = (OURS, "paper, 0.25 s", "I and Q at the commanded speed, 2")


def seen(nothing: int, objects: int) -> Iterator[dict[str, Any]]:
    """Of each detector and plate: how many of the passages see the object from 2.5 cm, and the median distance.
    Thresholds of the rivals are the largest value of passages before nothing."""
    largest = dict.fromkeys(NAMES, 0.0)
    for number in range(nothing):
        z, position_m, _ = pretouch_rooms.simulate(found := Passing(SEED_PRETOUCH, number, "empty", None))
        for name, s in pretouch_rooms.statistics(z, position_m, found.speed_m_s).items():
            if name in largest:
                largest[name] = max(largest[name], float(np.nanmax(s)))
    largest[OURS] = PreTouchSettings().threshold
    for plate in PLATES:
        for weaker_db in STRENGTHS_DB:
            gaps_m: dict[str, list[float]] = {name: [] for name in NAMES}
            for number in range(objects):
                thing = SIX[number // 10 % 6]
                passing = Passing(SEED_PRETOUCH + 1, number, "empty", thing, weaker_db, plate)
                z, position_m, gap_m = pretouch_rooms.simulate(passing)
                for name, s in pretouch_rooms.statistics(z, position_m, passing.speed_m_s).items():
                    if name in gaps_m:
                        above = np.flatnonzero(s > largest[name])
                        gaps_m[name].append(float(gap_m[above[0]]) if len(above) else 0.0)
            for name, each in gaps_m.items():
                yield {
                    "plate": plate,
                    "weaker_db": weaker_db,
                    "detector": name,
                    "seen": sum(one >= NEEDED_M for one in each),
                    "of": objects,
                    "median_m": float(np.median(each)),
                }


def _loudness(plate: tuple[int, int] | None) -> tuple[float, float]:
    """Of a pad's echo, over a point's, from 7 and from 10 mm."""
    if plate is None:
        return 1.0, 1.0
    near, far = plate_echo(
        plate, np.array([0.007, 0.010]), np.full(2, WAVE_RAD_M), AuraPlantSettings().decay_m
    )
    return abs(near), abs(far)


SOUND = {plate: _loudness(plate) for plate in PLATES}


def centred(every: int) -> Iterator[dict[str, Any]]:
    """Of each method and plate the score of every so manyth of 85 places: settings as they are, and measured anew with
    this pad as the profile of a bench says, an amplitude at 7 mm for ours, a power at 10 mm for the paper's."""
    as_they_are = centering.methods("mock/centering")
    for plate in PLATES:
        near, far = SOUND[plate]
        ours, paper = as_they_are["ours"], as_they_are["paper"]
        methods = as_they_are | {"ours, turned": replace(ours, turned=True)}
        if plate is not None:
            again = ours.set_to(level_fs=near * ours.finder["level_fs"])
            methods |= {"paper, set anew": paper.set_to(threshold=far**2 * paper.finder["threshold"])}
            methods |= {"ours, set anew": again, "ours, turned, set anew": replace(again, turned=True)}
        for speed_m_s in (0.01, 0.03):
            places = centering.eighty_five(SEED_CENTERING, 0, speed_m_s)[::every]
            for name, method in methods.items():
                found = [centering.search(place._replace(plate=plate), method) for place in places]
                yield {
                    "plate": plate,
                    "speed_m_s": speed_m_s,
                    "method": name,
                    "loudness": near,
                    **centering.score([found]),
                }


def main(quick: bool = False) -> None:
    """Run the study; writes results/plates.json."""
    many = (4, 4, 40) if quick else (60, 60, 3)
    save("plates", {"seen": list(seen(*many[:2])), "centred": list(centred(many[2]))}, quick=quick)


if __name__ == "__main__":
    main()
