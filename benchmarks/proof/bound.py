"""What nobody can tell: captures that a smooth scene behind the mask before explains as well.

Such a scene is a polynomial of the direction, fitted to a capture without noise. What is left over,
in units of the noise, is all by which any test could tell the two masks, unless it knows that the
scene is no such polynomial. A fit may be darker than black: so it explains a little too much.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from benchmarks.proof.cameras import FIELD_PIXELS
from benchmarks.proof.kinds import drawn, scaled
from benchmarks.proof.light import CHANNELS, Array, Singles
from benchmarks.proof.scenes import every_kind
from benchmarks.proof.world import HALF_SPACE, Extent, World

from veilcam_server.demo_data import Digits
from veilcam_training.bundle import Bundle

DEGREE = 8
"""Of the polynomials, along both axes together."""


@dataclass(frozen=True)
class Unexplained:
    """What smooth scenes leave over of captures of one kind.

    Attributes:
        kind: of the scene.
        outdoors: whether light comes from all of the half space, and not from a room's part of it.
        excess: chi-square per bin that is left over, in the median scene.
    """

    kind: str
    outdoors: bool
    excess: float


def unexplained(
    bundle: Bundle, digits: Digits, *, cameras: int, electrons: float, seed: int
) -> Iterator[Unexplained]:
    """What is left over of each kind of scene, without and with walls around the field.

    Args:
        bundle: whose camera and masks it is.
        digits: to draw from.
        cameras: how many are drawn.
        electrons: of a bin at full scale.
        seed: of all that is drawn.
    """
    few = Extent(masks=1, captures=3, objects=1, surroundings=1)
    found: dict[tuple[str, bool], list[float]] = {}
    for number in range(cameras):
        world = World(bundle, digits, np.random.SeedSequence([seed, number]), few)
        chance = np.random.default_rng([seed, number, 1])
        outdoors = world.sides == HALF_SPACE
        smooth = world.behind_last(polynomials(world.pixels))[1]
        for kind, draw in every_kind(digits, FIELD_PIXELS).items():
            due = world.behind_last(drawn(draw, world.pixels, chance))[0]
            light = scaled(due, 1.0)
            left = [excess(each, smooth, electrons) for each in light if each.any()]
            found.setdefault((kind, outdoors), []).extend(left)
    for (kind, outdoors), left in found.items():
        yield Unexplained(kind, outdoors, float(np.median(left)))


def polynomials(pixels: int) -> Singles:
    """Scenes that span all polynomials up to :data:`DEGREE`, (scenes, channels, pixels, pixels)."""
    at = np.linspace(-1, 1, pixels)
    lines = [np.polynomial.legendre.Legendre.basis(degree)(at) for degree in range(DEGREE + 1)]
    scenes = [
        np.multiply.outer(lines[down], lines[degree - down])
        for degree in range(DEGREE + 1)
        for down in range(degree + 1)
    ]
    return np.repeat(np.array(scenes, np.float32)[:, None], len(CHANNELS), axis=1)


def excess(light: Array, explanations: Singles, electrons: float) -> float:
    """Chi-square per bin that no sum of explanations takes away.

    Args:
        light: on the bins, over full scale.
        explanations: (explanations, *bins).
        electrons: of a bin at full scale.
    """
    deviation = np.sqrt(np.maximum(light, 1 / electrons) / electrons).ravel()
    columns = explanations.reshape(len(explanations), -1).T / deviation[:, None]
    wanted = light.ravel() / deviation
    fit = np.linalg.lstsq(columns, wanted, rcond=None)[0]
    return float(np.square(columns @ fit - wanted).mean())
