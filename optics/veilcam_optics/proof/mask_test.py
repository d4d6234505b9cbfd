"""The test of captures against the mask that they name.

The numbers in brackets are those of docs/proof.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
import numpy.typing as npt

from veilcam_optics.arrays import overwrite
from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.errors import OpticsError, require_shape, require_within
from veilcam_optics.keys.masks import Levels
from veilcam_optics.proof.finding import Alternative, Finding, Rival, judged
from veilcam_optics.proof.marks import Mark, Marks, even_light, weighed
from veilcam_optics.proof.traces import Bools, Single, Trace, Traces

PROOF = Embedding(48, 64)
"""To what measurements are binned for the test, whatever the embedding's size."""

STRANGERS = 64
"""Masks that are not there, the same ones always: they say what chance scores in a capture."""
_DARK = 10
"""Standard uncertainties of the dark measurement below which there is no light."""
_CLIPPED = 0.25
"""Share of clipped bins from which on nothing is decided."""
_LEAST = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class _Strangers:
    """Masks that are not there.

    Attributes:
        weights: of their frequencies, (strangers, frequencies).
        squares: of these.
    """

    weights: Single
    squares: Single

    @classmethod
    def of(cls, weights: Single) -> Self:
        """Those of some weights, (strangers, *frequencies)."""
        flat = weights.reshape(len(weights), -1)
        return cls(flat, np.square(flat))

    def chance(self, power: Single) -> tuple[Single, Single]:
        """Mean and standard deviation of their raw scores (eq. 4) in each trace, (captures,)."""
        raw = (self.weights @ power.T) / np.sqrt(np.maximum(self.squares @ power.T, _LEAST))
        return raw.mean(0), np.maximum(raw.std(0, ddof=1), _LEAST)


@dataclass(frozen=True)
class MaskTest:
    """Tests captures behind one mask. As secret as the mask, so its repr holds nothing.

    Made by :meth:`MaskTests.prepare`.
    """

    mark: Mark = field(repr=False)
    """Weighed, as that of its inversion is."""
    inverted: Mark = field(repr=False)
    transparent: Mark = field(repr=False)
    """Of an open window, as it is: light that bins and edges spread fills what is dark of it."""
    strangers: _Strangers = field(repr=False)
    unweighed: _Strangers = field(repr=False)
    """The same masks, by their marks as they are."""
    traces: Traces = field(repr=False)
    dark: float
    """Measurement below which there is no light."""
    even: float
    """Unevenness of even light behind the window."""

    def find(self, measurement: Single, clipped: Bools, before: Sequence[MaskTest] = ()) -> Finding:
        """What a capture says of its mask.

        Args:
            measurement: calibrated, shape of :data:`PROOF`.
            clipped: which of its bins hold a saturated pixel; they are left out.
            before: tests of other masks that the panel may have gone on showing, not erased.

        Raises:
            OpticsError: another shape, or numbers that are not finite.
        """
        return self.find_each(measurement[None], clipped[None], before)[0]

    def find_each(
        self, measurements: Single, clipped: Bools, before: Sequence[MaskTest] = ()
    ) -> list[Finding]:
        """What each of many captures says; :meth:`find` for (captures, *shape) at once."""
        for name, array in (("measurement", measurements), ("clipped", clipped)):
            require_shape(name, array, len(measurements), *PROOF.shape)
        if not bool(np.isfinite(measurements).all()):
            raise OpticsError("measurement holds NaN or infinity: use finite numbers")
        trace = self.traces.take(measurements, clipped)
        hidden = (clipped.mean((1, 2)) > _CLIPPED) | (trace.mean <= self.dark)
        return [
            Finding("undecided", 0.0, "another", 1.0, float(trace.mean[place]))
            if hidden[place]
            else found
            for place, found in enumerate(self._found(trace, before))
        ]

    def _found(self, trace: Trace, before: Sequence[MaskTest]) -> Iterator[Finding]:
        names: list[Alternative] = ["transparent", "inverted"]
        names += ["before"] * len(before)
        others = [self.transparent, self.inverted, *(each.mark for each in before)]
        marks = np.stack([self.mark.ravel(), *(mark.ravel() for mark in others)])
        root = np.sqrt(np.maximum(np.square(marks) @ trace.power.T, _LEAST))
        raw = marks @ trace.power.T / root
        mean, deviation = self.strangers.chance(trace.power)
        scores = (raw - mean) / deviation
        mean_open, deviation_open = self.unweighed.chance(trace.power)
        scores[1] = (raw[1] - mean_open) / deviation_open
        alike = (marks[0] * marks) @ trace.power.T / root[0] / root
        behind = (scores[0] - scores) / np.sqrt(np.maximum(2 - 2 * alike, _LEAST))
        gone = 1 - (raw[0] - mean) / root[0]
        for place, light in enumerate(trace.mean):
            rivals = [
                Rival(name, float(score), float(margin))
                for name, score, margin in zip(
                    names, scores[1:, place], behind[1:, place], strict=True
                )
            ]
            yield judged(
                float(scores[0, place]),
                rivals,
                unevenness=float(trace.unevenness[place]) / self.even,
                departure=float(gone[place]),
                light=float(light),
            )

    def erase(self) -> None:
        """Overwrite what is the mask's, as well as Python lets us."""
        overwrite(self.mark, self.inverted)


class MaskTests:
    """Prepares tests: all that does not depend on the mask, made once.

    Args:
        camera: nominal geometry.
        imperfections: of the camera as it was measured.
        dark: standard uncertainty of a measurement without light.

    Raises:
        OpticsError: imperfections that the camera cannot have, or a negative ``dark``.
    """

    def __init__(
        self, camera: Camera, *, imperfections: Imperfections = NOMINAL, dark: float = 1e-5
    ) -> None:
        imperfections.check(camera)
        require_within("dark", dark, "", 0, 1)
        self._camera, self._dark = camera, _DARK * dark
        self._marks, self._traces = Marks(camera, imperfections, PROOF), Traces(PROOF)
        even = self._traces.take(even_light(camera, PROOF)[None], np.zeros((1, *PROOF.shape), bool))
        self._even = float(even.unevenness[0])
        self._transparent = self._marks.mark(np.ones(camera.mask_shape))
        chance = np.random.default_rng(0)
        strangers = np.stack(
            [self._marks.mark(self._marks.shown(each)) for each in _drawn(camera, chance)]
        )
        self._strangers, self._unweighed = (
            _Strangers.of(each) for each in (weighed(strangers), strangers)
        )

    def prepare(self, levels: Levels) -> MaskTest:
        """The test of captures behind one mask.

        Args:
            levels: that the panel is told, ``camera.mask_shape``.

        Raises:
            OpticsError: levels of another shape, or more than the panel can show.
        """
        require_shape("levels", levels, *self._camera.mask_shape)
        top = self._camera.panel.levels - 1
        if int(levels.max()) > top:
            raise OpticsError(f"levels exceed what the panel can show: use 0 to {top}")
        shown = self._marks.shown(levels)
        # Around an inverted window the panel is open: what is missing within it casts the shadow.
        missing = 1 - self._marks.shown((top - levels).astype(np.uint8))
        mark, inverted = self._marks.mark(shown), self._marks.mark(missing)
        test = MaskTest(
            weighed(mark),
            weighed(inverted),
            self._transparent,
            self._strangers,
            self._unweighed,
            self._traces,
            self._dark,
            self._even,
        )
        overwrite(shown, missing)
        overwrite(mark, inverted)
        return test


def _drawn(camera: Camera, chance: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Levels of masks like any other, (strangers, rows, columns)."""
    return chance.integers(0, camera.panel.levels, (STRANGERS, *camera.mask_shape), dtype=np.uint8)
