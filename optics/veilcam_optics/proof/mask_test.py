"""The test of captures against the mask that they name.

The numbers in brackets are those of docs/proof.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from veilcam_optics.arrays import overwrite
from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.errors import OpticsError, require_shape, require_within
from veilcam_optics.keys.masks import Levels
from veilcam_optics.proof.finding import Alternative, Finding, Rival, judged
from veilcam_optics.proof.marks import Mark, Marks, even_light
from veilcam_optics.proof.strangers import STRANGERS, Strangers
from veilcam_optics.proof.traces import Bools, Single, Trace, Traces

PROOF = Embedding(48, 64)
"""To what measurements are binned for the test, whatever the embedding's size."""

_DARK = 10
"""Standard uncertainties of the dark measurement below which there is no light."""
_TEXTURED = 1.5
"""Times as uneven as behind an even panel light may be behind a mask."""
_CLIPPED = 0.25
"""Share of clipped bins from which on nothing is decided."""
_LEAST = 1e-6
"""Share of light that a panel misses at least."""


@dataclass(frozen=True)
class MaskTest:
    """Tests captures behind one mask. As secret as the mask, so its repr holds nothing.

    Made by :meth:`MaskTests.prepare`.
    """

    mark: Mark = field(repr=False)
    """Weighed, as that of its inversion is."""
    inverted: Mark = field(repr=False)
    window: Mark = field(repr=False)
    """Of the window without a mask, as it is."""
    strangers: Strangers = field(repr=False)
    traces: Traces = field(repr=False)
    dark: float
    """Measurement below which there is no light."""
    even: float
    """Unevenness of even light behind the window."""
    reach: float
    """Largest unevenness that the inverted panel leaves, over that."""

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
        marks = [self.mark, self.inverted, *(each.mark for each in before)]
        names: list[Alternative] = ["inverted"]
        names += ["before"] * len(before)
        scores = self.strangers.scores(trace, marks, self.window)
        for place, light in enumerate(trace.mean):
            unevenness = float(trace.unevenness[place]) / self.even
            named, *others = map(float, scores.score[:, place])
            window, behind = float(scores.window[place]), float(scores.ahead_of_window[place])
            rivals = [Rival("transparent", window, behind)]
            rivals += (
                Rival(name, other, float(ahead))
                for name, other, ahead in zip(names, others, scores.ahead[1:, place], strict=True)
                if name != "inverted" or unevenness <= self.reach
            )
            yield judged(
                named,
                rivals,
                unevenness=unevenness,
                departure=float(1 - scores.share[place]),
                light=float(light),
            )

    def erase(self) -> None:
        """Overwrite what is the mask's, as well as Python lets us."""
        self.mark.erase()
        self.inverted.erase()


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
        self._window = self._marks.mark(np.ones(camera.mask_shape))
        chance = np.random.default_rng(0)
        self._strangers = Strangers(
            [self._marks.mark(self._marks.shown(each)) for each in _drawn(camera, chance)]
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
        if int(np.max(levels)) > top:
            raise OpticsError(f"levels exceed what the panel can show: use 0 to {top}")
        shown = self._marks.shown(levels)
        # Around an inverted window the panel is open: what is missing within it casts the shadow.
        missing = 1 - self._marks.shown((top - levels).astype(np.uint8))
        mark, inverted = self._marks.mark(shown), self._marks.mark(missing)
        test = MaskTest(
            mark.weighed(),
            inverted.weighed(),
            self._window,
            self._strangers,
            self._traces,
            self._dark,
            self._even,
            _reach(float(missing.mean())) / self._even,
        )
        overwrite(shown, missing)
        overwrite(mark.texture, inverted.texture)
        return test


def _reach(missing: float) -> float:
    """Largest unevenness of light around a window that misses a share of it.

    One lamp casts a shadow over a share ``q`` of the sensor's width; what is left there is
    ``1 - missing``, with an rms of ``missing sqrt(q (1 - q))`` over a mean of ``1 - missing q``,
    which is largest at ``q = 1 / (2 - missing)``.
    """
    return _TEXTURED * missing / 2 / math.sqrt(max(1 - missing, _LEAST))


def _drawn(camera: Camera, chance: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Levels of masks like any other, (strangers, rows, columns)."""
    return chance.integers(0, camera.panel.levels, (STRANGERS, *camera.mask_shape), dtype=np.uint8)
