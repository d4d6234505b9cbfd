"""What nobody can tell: captures that another scene behind the mask before explains as well.

Such a scene is a polynomial of the direction, or a sum of copies of the true one, each moved and
lit otherwise, fitted to a capture without noise. What is left over, in units of the noise, is all
by which any test could tell the two masks, unless it knows the scene better than as one of these.
A fit may be darker than black: so it explains a little too much.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
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
LIT = 2
"""Degree of the polynomials by which copies of a scene are lit."""
MOVES = (-8, -4, -2, -1, 1, 2, 4, 8)
"""Of these copies along each axis [pixels of the field]."""
COPIED = 2
"""Scenes of a kind whose copies are tried, of each camera."""


@dataclass(frozen=True)
class Unexplained:
    """What smooth scenes leave over of captures of one kind.

    Attributes:
        kind: of the scene.
        outdoors: whether light comes from all of the half space, and not from a room's part of it.
        excess: chi-square per bin that polynomials leave over, in the median scene.
        copied: the same where copies of the scene explain it, too.
    """

    kind: str
    outdoors: bool
    excess: float
    copied: float


def unexplained(
    bundle: Bundle,
    digits: Digits,
    *,
    cameras: int,
    electrons: float,
    seed: int,
    kinds: Collection[str] | None = None,
) -> Iterator[Unexplained]:
    """What is left over of each kind of scene, without and with walls around the field.

    Args:
        bundle: whose camera and masks it is.
        digits: to draw from.
        cameras: how many are drawn.
        electrons: of a bin at full scale.
        seed: of all that is drawn.
        kinds: of scenes, by name; None for every one.
    """
    few = Extent(masks=1, captures=3, objects=1, surroundings=1)
    found: dict[tuple[str, bool], tuple[list[float], list[float]]] = {}
    for number in range(cameras):
        world = World(bundle, digits, np.random.SeedSequence([seed, number]), few)
        chance = np.random.default_rng([seed, number, 1])
        smooth = world.behind_last(polynomials(world.pixels))[1]
        for kind, draw in every_kind(digits, FIELD_PIXELS).items():
            if kinds is not None and kind not in kinds:
                continue
            scenes = drawn(draw, world.pixels, chance)
            light = scaled(world.behind_last(scenes)[0], 1.0)
            left, copied = found.setdefault((kind, world.sides == HALF_SPACE), ([], []))
            left += [excess(each, smooth, electrons) for each in light if each.any()]
            for scene, each in zip(scenes[:COPIED], light, strict=False):
                if each.any():
                    both = np.concatenate([smooth, world.behind_last(copies(scene))[1]])
                    copied.append(excess(each, both, electrons))
    for (kind, outdoors), (left, copied) in found.items():
        yield Unexplained(kind, outdoors, float(np.median(left)), float(np.median(copied)))


def copies(scene: Singles) -> Singles:
    """One scene in its place and moved along each axis, each lit in every way that is smooth.

    Args:
        scene: (channels, pixels, pixels).
    """
    moves = [(0, 0), *((move, 0) for move in MOVES), *((0, move) for move in MOVES)]
    moved = np.stack([np.roll(scene, move, (1, 2)) for move in moves])
    lights = polynomials(scene.shape[1], LIT)
    several: Singles = (moved[:, None] * lights).reshape(-1, *scene.shape)
    return several


def polynomials(pixels: int, highest: int = DEGREE) -> Singles:
    """Scenes that span all polynomials up to a degree, (scenes, channels, pixels, pixels)."""
    at = np.linspace(-1, 1, pixels)
    lines = [np.polynomial.legendre.Legendre.basis(degree)(at) for degree in range(highest + 1)]
    scenes = [
        np.multiply.outer(lines[down], lines[degree - down])
        for degree in range(highest + 1)
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
