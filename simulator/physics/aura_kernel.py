"""The sound field of two fingers, instant by instant. Compiled. The equations are those of docs/explanation/aura.md."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.compiled import compiled
from drivers.core.messages import Floats, Ints
from simulator.physics.aura_settings import PAD_LENGTH_M, PAD_WIDTH_M
from simulator.physics.noise import normal

Complexes = NDArray[np.complex128]
Counts = NDArray[np.int32]

HALF_WIDTH_M = 0.5 * PAD_WIDTH_M
HALF_LENGTH_M = 0.5 * PAD_LENGTH_M


class Air(NamedTuple):
    """How sound spreads: see `AuraPlantSettings`; `loss_np_m` is what air takes on each metre, in nepers."""

    decay_m: float
    decay_power: float
    loss_np_m: float
    bounce: float
    edge: float


class AuraThing(NamedTuple):
    """What stands there. Heights are over the middle of a finger at the start pose; strength is what reflects."""

    strength: float
    half_depth_m: float
    bottom_m: float
    top_m: float
    radius_m: float


@compiled()
def spread(distance_m: float, radius_m: float, air: Air) -> float:
    """Amplitude of what comes back from a distance, as a share of that from none."""
    lost = air.decay_power * math.log(1.0 + distance_m / air.decay_m) + 2.0 * air.loss_np_m * distance_m
    return math.exp(-lost) * math.sqrt(radius_m / (radius_m + distance_m))


@compiled()
def behind(way_m: float, wave_rad_m: float) -> complex:
    """By how much of a turn sound is late after a way."""
    angle_rad = wave_rad_m * way_m
    return complex(math.cos(angle_rad), -math.sin(angle_rad))


@compiled()
def faced(y_m: float, z_m: float, thing: AuraThing) -> tuple[float, float, float]:
    """What of a finger's pad has the object before it across and lengthwise, 0 to 1, and how far beside it that is."""
    across_m = min(thing.half_depth_m, y_m + HALF_WIDTH_M) - max(-thing.half_depth_m, y_m - HALF_WIDTH_M)
    along_m = min(thing.top_m, z_m + HALF_LENGTH_M) - max(thing.bottom_m, z_m - HALF_LENGTH_M)
    beside_m = math.hypot(min(across_m, 0.0), min(along_m, 0.0))
    return max(across_m, 0.0) / (2.0 * HALF_WIDTH_M), max(along_m, 0.0) / (2.0 * HALF_LENGTH_M), beside_m


@compiled()
def reflected(
    gap_m: float, y_m: float, z_m: float, wave_rad_m: float, strength: float, thing: AuraThing, air: Air
) -> complex:
    """What a finger receives back, as a share of what a wide flat rigid wall at no distance sends.

    Args:
        gap_m: From the finger's side to the object, in the direction in which the side looks.
        y_m: Place of the finger's middle across, from the object's.
        z_m: Height of the finger's middle over its own at the start pose.
        strength: Of side and object together.
    """
    across, along, beside_m = faced(y_m, z_m, thing)
    share = strength * (air.edge + (1.0 - air.edge) * across)
    distance_m = math.hypot(gap_m, beside_m)
    received = 0.0j
    if along > 0.0:
        size = share * along * spread(distance_m, thing.radius_m, air)
        received += size * behind(2.0 * distance_m, wave_rad_m)
    aside_m = math.hypot(gap_m, max(0.0, abs(y_m) - thing.half_depth_m - HALF_WIDTH_M))
    for end_m in (thing.top_m, thing.bottom_m):
        way_m = math.hypot(aside_m, z_m - end_m)
        size = share * air.edge * spread(way_m, thing.radius_m, air)
        received += size * behind(2.0 * way_m, wave_rad_m)
    return received / (1.0 - air.bounce * received)


@compiled()
def reflections(
    gap_m: Floats,
    y_m: Floats,
    z_m: Floats,
    wave_rad_m: Floats,
    strength: float,
    thing: AuraThing,
    air: Air,
    out: Complexes,
) -> None:
    """`reflected` at many instants, each array of shape (n,)."""
    for i in range(gap_m.size):
        out[i] = reflected(max(gap_m[i], 0.0), y_m[i], z_m[i], wave_rad_m[i], strength, thing, air)


@compiled()
def crossings(
    width_m: Floats,
    gaps_m: Floats,
    y_m: Floats,
    z_m: Floats,
    wave_rad_m: Floats,
    thing: AuraThing,
    air: Air,
    out: Complexes,
) -> None:
    """What a finger receives of the other across the jaws, through the air and around an object between them.

    Args:
        width_m: Opening, shape (n,).
        gaps_m: Distances of both fingers from the object added up, shape (n,).
        y_m: As in `reflected`, shape (n,).
        z_m: Likewise.
        thing: The object; strength 0 for none.
        out: Shape (n,).
    """
    hidden, size, known_m = 0.0, 0.0, math.nan
    for i in range(width_m.size):
        if thing.strength > 0.0:
            across, along, _ = faced(y_m[i], z_m[i], thing)
            hidden = across * along
        way_m = width_m[i]
        out[i] = 0.0
        if hidden < 1.0:
            if way_m != known_m:  # jaws stand still for most of the time
                size, known_m = math.exp(-air.decay_power * math.log(1.0 + way_m / air.decay_m)), way_m
            out[i] += (1.0 - hidden) * size * behind(way_m, wave_rad_m[i])
        if hidden > 0.0:
            through = thing.strength * hidden * spread(0.5 * gaps_m[i], thing.radius_m, air)
            out[i] += through * behind(gaps_m[i], wave_rad_m[i])


@compiled()
def slow_waves(times_s: Floats, rates_rad_s: Floats, phases_rad: Floats, out: Complexes) -> None:
    """Sums of cosines, for what wanders slowly: phases of shape (m, 2), out of shape (n,), I and Q."""
    for i in range(times_s.size):
        real, imaginary = 0.0, 0.0
        for j in range(rates_rad_s.size):
            real += math.cos(rates_rad_s[j] * times_s[i] + phases_rad[j, 0])
            imaginary += math.cos(rates_rad_s[j] * times_s[i] + phases_rad[j, 1])
        out[i] = complex(real, imaginary)


@compiled()
def modulated(envelope: Complexes, phase_rad: Floats, noise: Floats, counts: int, out: Counts) -> None:
    """A carrier with this envelope, with noise, as a converter counts it.

    Args:
        envelope: Of each finger, shape (n, 2).
        phase_rad: Of the drive, shape (n,).
        noise: Of each finger, shape (2, n).
        counts: Of full scale.
        out: Shape (n, 2).
    """
    for i in range(phase_rad.size):
        cosine, sine = math.cos(phase_rad[i]), math.sin(phase_rad[i])
        for k in range(out.shape[1]):
            wave = envelope[i, k].real * cosine - envelope[i, k].imag * sine
            out[i, k] = min(max(np.rint((wave + noise[k, i]) * counts), -counts), counts - 1)


@compiled()
def echoed(seed: int, trial: int, stream: int, numbers: Ints, weights: Floats, out: Floats) -> None:
    """Noise that remembers: of each sample its own deviate and those before it, weighted; shape (n,).

    Args:
        numbers: Of the samples, shape (n,).
        weights: Of a sample's own deviate, of that before it and so on.
        out: Shape (n,).
    """
    deviates = np.zeros(weights.size)
    for i in range(numbers.size):
        known = weights.size - 1 if i > 0 and numbers[i] == numbers[i - 1] + 1 else 0
        for back in range(known, 0, -1):
            deviates[back] = deviates[back - 1]
        deviates[0] = normal(seed, trial, stream, numbers[i])
        for back in range(known + 1, weights.size):
            deviates[back] = normal(seed, trial, stream, numbers[i] - back)
        total = 0.0
        for back in range(weights.size):
            total += weights[back] * deviates[back]
        out[i] = total
