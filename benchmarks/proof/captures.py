"""Captures: light on a sensor that is read row by row, and what its calibration makes of it.

Under a rolling shutter a row's light is that of its own time: lamps flicker, things move. Light is
added up from objects and surroundings that were sent through the panel before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt
from benchmarks.proof.cameras import Belief, Build
from benchmarks.proof.light import BINS, Array, Singles

Level = Literal["bright", "middle", "dim"]
LEVELS: tuple[Level, ...] = get_args(Level)
SHARE = {"bright": 1.0, "middle": 0.1, "dim": 0.01}
"""Of full scale: where the brightest bins of a capture are, or up to half below that."""
CLIPPED = 0.02
"""Most bins that a healthy capture clips; a camera exposes a brighter scene for a quarter."""
READOUT = 1520 * 15.17e-6
"""From the first row's readout to the last one's [s]."""
MAINS = (50.0, 60.0, 100.0, 120.0)
"""At which lamps flicker [Hz]."""
FLICKER = 0.2
"""Largest amplitude of a lamp's flicker, over its mean."""
EXTREME = 0.15
"""Share of captures whose surroundings are black, and share of those where they are all lit."""

Bools = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Plan:
    """What is captured, and in which light; each attribute has a value for each capture.

    Attributes:
        object: which one.
        surroundings: which ones.
        shares: of the object's and the surroundings' light that is there, (2, captures).
        moving: how far the object gets to its second place while the sensor is read, 0 to 1.
        flicker: amplitude of the lamp over each of the two, (2, captures).
        frequency: of the flicker [Hz].
        phase: of the flicker when the first row is read, (2, captures) [rad].
        exposure: of a row [s].
        brightness: where the brightest bins are, over full scale.
        clipping: share of bins that are brighter than that.
        peak: brightest pixel of a bin over its mean.
        level: which of :data:`LEVELS`.
    """

    object: Indices
    surroundings: Indices
    shares: Array
    moving: Array
    flicker: Array
    frequency: Array
    phase: Array
    exposure: Array
    brightness: Array
    clipping: Array
    peak: Array
    level: Indices

    def __len__(self) -> int:
        return len(self.object)


def draw_plan(count: int, objects: int, surroundings: int, chance: np.random.Generator) -> Plan:
    """So many captures; a third of them in each light.

    Args:
        count: of captures.
        objects: to draw from.
        surroundings: to draw from.
        chance: source of the random numbers.
    """
    level = np.arange(count) % len(LEVELS)
    fate = chance.random(count)
    share = np.select([fate < EXTREME, fate > 1 - EXTREME], [0.0, 1.0], chance.random(count))
    bright = level == LEVELS.index("bright")
    lamps = chance.uniform(0, FLICKER, (2, count))
    phase = chance.uniform(0, 2 * np.pi, (2, count))
    one = chance.random(count) < 0.5
    return Plan(
        object=chance.integers(objects, size=count),
        surroundings=chance.integers(surroundings, size=count),
        # An empty room is lit, and what is there without a room is an object.
        shares=np.stack([(chance.random(count) < 0.9) | (share == 0), share]).astype(np.float64),
        moving=chance.random(count) * (chance.random(count) < 0.5),
        flicker=np.where(one, lamps[0], lamps),
        frequency=chance.choice(MAINS, count),
        phase=np.where(one, phase[0], phase),
        exposure=10 ** chance.uniform(-3, -1.7, count),
        brightness=chance.uniform(0.5, 1, count) * [SHARE[LEVELS[each]] for each in level],
        clipping=np.where(bright, chance.uniform(0, CLIPPED, count), 0.0),
        peak=chance.uniform(1, 1.2, count),
        level=level,
    )


def lit(plan: Plan, objects: Singles, surroundings: Singles) -> Array:
    """Light on the sensor in each capture, not yet bright or dim: (captures, *BINS).

    Args:
        plan: of the captures.
        objects: on the sensor, and those that moved: (2 x objects, *BINS).
        surroundings: on the sensor, (surroundings, *BINS).
    """
    went = plan.moving[:, None] * np.linspace(0, 1, BINS[0])
    gains = row_gains(plan)
    still, moved = objects[2 * plan.object], objects[2 * plan.object + 1]
    near = (1 - went)[..., None] * still + went[..., None] * moved
    far = surroundings[plan.surroundings]
    total: Array = np.einsum("cn,cnr,cnrx->nrx", plan.shares, gains, np.stack([near, far]))
    return total


def row_gains(plan: Plan) -> Array:
    """Light of a flickering lamp in each row of bins over its mean: (2, captures, rows)."""
    turns = plan.frequency[:, None] * READOUT * (np.arange(BINS[0]) + 0.5) / BINS[0]
    # The mean over a row's exposure, and over the rows of a bin.
    left = np.sinc(plan.frequency * plan.exposure) * np.sinc(plan.frequency * READOUT / BINS[0])
    waves = np.cos(2 * np.pi * turns + plan.phase[..., None])
    gains: Array = 1 + (plan.flicker * left)[..., None] * waves
    return gains


def scales(plan: Plan, healthy: Array, build: Build) -> Array:
    """By what the light of each capture is multiplied, so that it is as bright as planned.

    Args:
        plan: of the captures.
        healthy: light behind the mask that is due, (captures, *BINS).
        build: whose full scale it is.
    """
    ordered = np.sort(healthy.reshape(len(plan), -1), axis=1)
    below = ordered.shape[1] - 1 - (plan.clipping * ordered.shape[1]).astype(np.intp)
    brightest = ordered[np.arange(len(plan)), below] * plan.peak
    scale: Array = plan.brightness * build.full_scale / np.maximum(brightest, 1e-12)
    return scale


def exposed(
    light: Array, peak: Array, build: Build, belief: Belief, chance: np.random.Generator
) -> tuple[Singles, Bools]:
    """What a calibrated sensor gives for light, and which of its bins are clipped.

    Args:
        light: (captures, *BINS).
        peak: brightest pixel of a bin over its mean, (captures,).
        build: the camera.
        belief: what it was calibrated to.
        chance: source of the noise.
    """
    stray = build.imperfections.stray_light
    mean = light.mean((1, 2), keepdims=True)
    light = (1 - stray) * light + stray * mean
    most = np.full((len(light), 1, 1), build.full_scale)
    crest = peak[:, None, None]
    while True:
        over = light * crest > most
        wanting = over.mean((1, 2), keepdims=True) > 1.5 * CLIPPED
        if not wanting.any():
            break
        most = np.where(wanting, 4 * most, most)
    kept = np.minimum(light - 0.3 * np.maximum(light * crest - most, 0), most)
    unit = most / build.electrons
    noise = np.sqrt(np.maximum(kept, 0) * unit + (build.read_noise * unit) ** 2)
    raw = kept + noise * chance.standard_normal(light.shape)
    clean = (np.minimum(raw, most) - belief.black) / belief.gain
    known = belief.imperfections.stray_light
    straight = (clean - known * clean.mean((1, 2), keepdims=True)) / (1 - known)
    return straight.astype(np.float32), over | build.hot
