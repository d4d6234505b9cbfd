"""What can be decided in which scene: each kind alone, behind the mask that is due and another."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from benchmarks.proof.cameras import FIELD_PIXELS
from benchmarks.proof.captures import exposed
from benchmarks.proof.light import CHANNELS, Array, Singles
from benchmarks.proof.scenes import Draw, every_kind
from benchmarks.proof.world import Extent, World

from veilcam_optics.proof import MaskTests, Verdict
from veilcam_server.demo_data import Digits
from veilcam_training.bundle import Bundle

SCENES = 8
"""Of each kind that a camera sees."""
BRIGHTEST = 0.8
"""Where the brightest bins are, over full scale."""


@dataclass(frozen=True)
class Share:
    """How captures of one kind of scene ended.

    Attributes:
        kind: of the scene.
        electrons: of a bin at full scale.
        seen: share of captures behind the mask that is due.
        accused: share of them that were taken for another state of the panel.
        found: share of captures behind the mask before.
    """

    kind: str
    electrons: float
    seen: float
    accused: float
    found: float


def by_kind(
    bundle: Bundle,
    digits: Digits,
    tests: Callable[[World], MaskTests],
    *,
    cameras: int,
    electrons: tuple[float, ...],
    seed: int,
) -> list[Share]:
    """Share of verdicts for each kind of scene, and each noise.

    Args:
        bundle: whose camera and masks it is.
        digits: to draw from.
        tests: makes a camera's tests from what is believed of it.
        cameras: how many are drawn.
        electrons: of a bin at full scale.
        seed: of all that is drawn.
    """
    few = Extent(masks=1, captures=3, objects=1, surroundings=1)
    counts: dict[tuple[str, float, bool], Counter[Verdict]] = {}
    kinds = every_kind(digits, FIELD_PIXELS)
    for number in range(cameras):
        world = World(bundle, digits, np.random.SeedSequence([seed, number]), few)
        chance = np.random.default_rng([seed, number, 1])
        proof = tests(world)
        before, test = (proof.prepare(world.masks[-back]) for back in (2, 1))
        for kind, draw in kinds.items():
            lights = world.behind_last(drawn(draw, world.pixels, chance))
            for many in electrons:
                build = replace(world.build, electrons=many, read_noise=0.0)
                for due, light in zip((True, False), lights, strict=True):
                    bright = scaled(light, build.full_scale)
                    crest = np.ones(len(bright))
                    captures, clipped = exposed(bright, crest, build, world.belief, chance)
                    found = test.find_each(captures, clipped, [before])
                    counted = counts.setdefault((kind, many, due), Counter())
                    counted.update(each.verdict for each in found)
    return list(_shares(counts))


def drawn(draw: Draw, pixels: int, chance: np.random.Generator) -> Singles:
    """Scenes of one kind that are not black, (scenes, channels, pixels, pixels)."""
    scenes: list[Array] = []
    while len(scenes) < SCENES:
        scene = draw(pixels, chance)
        if scene.any():
            scenes.append(scene)
    return np.repeat(np.array(scenes, np.float32)[:, None], len(CHANNELS), axis=1)


def scaled(light: Singles, full_scale: float) -> Array:
    """Light whose brightest bins are at :data:`BRIGHTEST`, in measurements."""
    brightest = np.maximum(light.max((1, 2), keepdims=True), 1e-12)
    scaled: Array = light.astype(np.float64) / brightest * (BRIGHTEST * full_scale)
    return scaled


def _shares(counts: dict[tuple[str, float, bool], Counter[Verdict]]) -> Iterator[Share]:
    for kind, many in dict.fromkeys((kind, many) for kind, many, _ in counts):
        due, other = counts[kind, many, True], counts[kind, many, False]
        yield Share(
            kind,
            many,
            seen=due["seen"] / due.total(),
            accused=due["not seen"] / due.total(),
            found=other["not seen"] / other.total(),
        )
