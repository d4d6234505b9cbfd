"""One camera in its world: masks that follow each other, scenes, and captures behind them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from benchmarks.proof.cameras import FIELD_PIXELS, Belief, Build, draw_belief, draw_build
from benchmarks.proof.captures import Bools, Plan, draw_plan, exposed, lit, scales
from benchmarks.proof.faults import FAULTS, SHIFTS, Fault, fault_patches, shifted_patches
from benchmarks.proof.light import BINS, Array, Optics, Singles
from benchmarks.proof.scenes import draw_objects, draw_surroundings

from veilcam_optics.keys.masks import KEY_BYTES, Levels, draw_levels
from veilcam_server.demo_data import Digits
from veilcam_training.bundle import Bundle

Seed = int | np.random.SeedSequence

NARROWEST, WIDEST = 3.0, 7.0
"""Field of light between which cameras' are drawn, in the task's squares."""
HALF_SPACE = 7.2, 9.4
"""Field along y and x from which light reaches the sensor at all, in the task's squares."""
OUTDOORS = 0.3
"""Share of cameras to which light comes from all of the half space."""
NEAREST, FARTHEST = 0.3, 10.0
"""Depths that are drawn between, evenly in the logarithm; beyond is infinite [m]."""
LEAD = 2
"""Masks that were shown before the first one that is due."""
WHOLE: tuple[Fault, ...] = ("bare", "inverted")
"""Faults of a panel that is open around its window."""
STATES = (*FAULTS, *(f"shifted {down} {right}" for down, right in SHIFTS))


@dataclass(frozen=True)
class Extent:
    """How much is drawn of one camera's world.

    Attributes:
        masks: that are due one after the other.
        captures: behind each of them.
        objects: that they are drawn from.
        surroundings: that they are drawn from.
        tint: standard deviation of a channel's light over that of the calibration, as a logarithm.
        electrons: of a bin at full scale; None draws them for each camera.
    """

    masks: int = 6
    captures: int = 561
    objects: int = 10
    surroundings: int = 16
    tint: float = 0.0
    electrons: float | None = None


@dataclass(frozen=True)
class Batch:
    """Captures behind one state of the panel, of which ``levels`` are due.

    Attributes:
        levels: of the mask that captures name.
        before: of the mask that was due before that one.
        earlier: of the one before that.
        plan: of the captures.
        measurements: calibrated, (captures, *BINS).
        clipped: which of their bins are, (captures, *BINS).
        state: of the panel: ``healthy``, a fault, or ``shifted`` by lines.
    """

    levels: Levels
    before: Levels
    earlier: Levels
    plan: Plan
    measurements: Singles
    clipped: Bools
    state: str


class World:
    """What one camera sees; the same for the same seed.

    Args:
        bundle: whose camera and masks it is.
        digits: that it may see.
        seed: of all that is drawn.
        extent: how much that is.
    """

    def __init__(self, bundle: Bundle, digits: Digits, seed: Seed, extent: Extent) -> None:
        self._chance = np.random.default_rng(seed)
        self._extent = extent
        self.build: Build = draw_build(bundle.camera, self._chance, extent.electrons)
        self.belief: Belief = draw_belief(self.build, self._chance)
        self.sides = self._sides()
        self.depths = self._depth(), self._depth()
        self._optics: tuple[Optics, ...] = tuple(
            self.build.optics(bundle.scene, sides=self.sides, depth=depth) for depth in self.depths
        )
        self.pixels = pixels = round(max(self.sides) * FIELD_PIXELS)
        tint = extent.tint
        objects = draw_objects(
            extent.objects,
            pixels,
            square=FIELD_PIXELS,
            digits=digits,
            tint=tint,
            chance=self._chance,
        )
        surroundings = draw_surroundings(extent.surroundings, pixels, tint, self._chance)
        self._objects, self._surroundings = self._faded(objects), self._faded(surroundings)
        self.masks = list(self._sequence(bundle))

    def healthy(self) -> Iterator[Batch]:
        """Captures behind every mask that is due, as it is due."""
        due = range(LEAD, len(self.masks))
        seen = self._seen(np.stack([self.build.patch(self.masks[place]) for place in due]))
        for place, objects, surroundings in zip(due, *seen, strict=True):
            plan = self._plan()
            light = lit(plan, objects, surroundings)
            yield self._captured(place, plan, light, scales(plan, light, self.build), "healthy")

    def faulty(self) -> Iterator[Batch]:
        """Captures of the same scenes, in the same light, behind each fault and shift."""
        due = range(LEAD, len(self.masks))
        seen = self._seen(np.concatenate([self._states(place) for place in due]))
        behind = [each.reshape(len(due), -1, *each.shape[1:]) for each in seen]
        for place, *scenes in zip(due, *behind, strict=True):
            plan = self._plan()
            healthy, *lights = [lit(plan, *each) for each in zip(*scenes, strict=True)]
            scale = scales(plan, healthy, self.build)
            around = lit(plan, *self._uncovered()) - lights[STATES.index("bare")]
            for state, light in zip(STATES, lights, strict=True):
                outside = around if state in WHOLE else 0.0
                yield self._captured(place, plan, light + outside, scale, state)

    def behind_last(self, scenes: Singles) -> Singles:
        """Light of scenes, as far away as surroundings, behind the last mask and the one before it.

        Args:
            scenes: (scenes, channels, pixels, pixels).

        Returns:
            (2, scenes, *BINS).
        """
        patches = np.stack([self.build.patch(self.masks[-back]) for back in (1, 2)])
        return self._optics[1].measurements(self._faded(scenes), patches)

    def _states(self, place: int) -> Singles:
        """Amplitudes of the panel: as is due, and for each of ``STATES``."""
        due, before, earlier = (self.masks[place - back] for back in range(LEAD + 1))
        return np.concatenate(
            [
                self.build.patch(due)[None],
                fault_patches(self.build, due, before, earlier),
                shifted_patches(self.build, due),
            ]
        )

    def _plan(self) -> Plan:
        extent = self._extent
        return draw_plan(extent.captures, extent.objects, extent.surroundings, self._chance)

    def _seen(self, patches: Singles) -> tuple[Singles, Singles]:
        """Objects and surroundings on the sensor, each (patches, scenes, *BINS)."""
        near, far = self._optics
        return near.measurements(self._objects, patches), far.measurements(
            self._surroundings, patches
        )

    def _captured(self, place: int, plan: Plan, light: Array, scale: Array, state: str) -> Batch:
        light = light * scale[:, None, None]
        measurements, clipped = exposed(light, plan.peak, self.build, self.belief, self._chance)
        due, before, earlier = (self.masks[place - back] for back in range(LEAD + 1))
        return Batch(due, before, earlier, plan, measurements, clipped, state)

    def _uncovered(self) -> tuple[Singles, Singles]:
        """Objects and surroundings behind a panel that is open everywhere, each (scenes, *BINS)."""
        near, far = (
            np.broadcast_to(optics.uncovered(scenes)[:, None, None], (len(scenes), *BINS))
            for optics, scenes in zip(
                self._optics, (self._objects, self._surroundings), strict=True
            )
        )
        return near, far

    def _sides(self) -> tuple[float, float]:
        if self._chance.random() < OUTDOORS:
            return HALF_SPACE
        width = self._chance.uniform(NARROWEST, WIDEST)
        return width, width

    def _faded(self, scenes: Singles) -> Singles:
        """What falls obliquely is fainter: by the solid angle of a slope, and on the sensor."""
        slopes = [slits.field.slopes for slits in (self._optics[0].rows, self._optics[0].columns)]
        cut = (scenes.shape[2] - len(slopes[0])) // 2
        cosines = 1 / np.sqrt(1 + np.add.outer(slopes[0] ** 2, slopes[1] ** 2))
        faded: Singles = scenes[:, :, cut : cut + len(slopes[0])] * cosines.astype(np.float32) ** 4
        return faded

    def _depth(self) -> float:
        drawn = math.exp(self._chance.uniform(math.log(NEAREST), math.log(2 * FARTHEST)))
        return drawn if drawn < FARTHEST else math.inf

    def _sequence(self, bundle: Bundle) -> Iterator[Levels]:
        """Masks that are due, and those before them. Three in a row differ."""
        shown: list[int] = []
        for _ in range(LEAD + self._extent.masks):
            if bundle.fresh is not None:
                key = self._chance.bytes(KEY_BYTES)
                yield draw_levels(key, camera=bundle.camera, distribution=bundle.fresh.distribution)
                continue
            others = [pair for pair in range(len(bundle.pairs)) if pair not in shown[-2:]]
            shown.append(int(self._chance.choice(others)))
            yield bundle.pairs[shown[-1]].levels
