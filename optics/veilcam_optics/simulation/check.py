"""A check of one mask: entries of its transfer drawn at random, against the full field.

Entries are drawn by how bright the plan takes them for, and half of them evenly, so that light that
the plan misses is found. Each is integrated with every pair of sub-pixels that interferes, at the
angle of its own scene pixel, and over its own box alone: Gauss-Legendre nodes that resolve the
finest fringe. Nothing of the plan's kernels, reach, zones or samples is used.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from scipy.special import stdtrit
from torch import Tensor

from veilcam_optics.camera.inputs import check_weights
from veilcam_optics.effects.composition import beams, shown
from veilcam_optics.effects.light import fade, stretch, tangents
from veilcam_optics.effects.mask import actual_camera
from veilcam_optics.effects.model import Model
from veilcam_optics.effects.sensor import channel_shares
from veilcam_optics.errors import OpticsError, require, require_count
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.entries import BoxFields, node_count
from veilcam_optics.transfer.kernels import Axis
from veilcam_optics.transfer.tables import make_axes

CONFIDENCE = 0.9
"""Of the interval."""

_NOMINAL = 0.96
"""For which it is made: of few entries with a heavy tail it holds the truth less often."""

_WORK = 1e7
"""Field values of all entries together: a second or two of one core."""

_FEWEST = 8
"""Entries below which a spread says nothing."""

_WAVELENGTHS, _LAYERS = 7, 7
"""Samples of a channel's spectrum and of the scene's depth: more than any plan's five."""


@dataclass(frozen=True, slots=True)
class Check:
    """The error of one mask's transfer, from some of its entries.

    Attributes:
        error: relative L2 error, estimated.
        low: lower end of its interval of confidence.
        high: upper end.
        confidence: confidence of the interval.
        entries: number of entries that were drawn.
    """

    error: float
    low: float
    high: float
    confidence: float
    entries: int

    def __str__(self) -> str:
        return (
            f"{self.error:.2g} ({self.low:.2g} to {self.high:.2g} with a confidence of "
            f"{100 * self.confidence:.0f} %, from {self.entries} entries)"
        )


def check(
    operator: LightOperator, asked: Model, weights: Tensor, *, entries: int = 48, seed: int = 0
) -> Check:
    """Estimate the relative L2 error of one mask's transfer.

    The full field is Fresnel's, as every factored field is; what that leaves out of exact light
    stands in a plan's table.

    Args:
        operator: operator that a plan chose.
        asked: model with every effect, which the operator stands for.
        weights: amplitude transmittances asked of the panel, ``camera.mask_shape``.
        entries: number of entries to draw; fewer where that would take seconds.
        seed: seed of the draw.

    Raises:
        OpticsError: the mask has another shape or holds NaN; fewer than 8 entries; a turned mask;
            fringes too fine for 8 entries.
    """
    require_count("entries", entries, least=_FEWEST)
    check_weights(weights, asked.camera)
    turned = asked.conditions.imperfections.rotation
    require(turned == 0, "imperfections.rotation", turned, "rad", "0: a turned mask has no check")
    field = FullField(asked, weights)
    entries = min(entries, int(_WORK / field.values))
    if entries < _FEWEST:
        raise OpticsError(
            f"a check takes {field.values:.2g} field values for an entry: use a smaller window, "
            "a larger distance or more embedding pixels"
        )
    generator = np.random.default_rng(seed)
    count = asked.scene.rows * asked.scene.columns
    points = generator.integers(count, size=entries)
    rows = _rows(operator, weights, points)
    chances = chances_of(rows)
    pixels = np.array([generator.choice(len(chance), p=chance) for chance in chances])
    here = np.arange(entries)
    share = asked.conditions.imperfections.stray_light
    # Spreading light evenly keeps the mean of a row, whose own error counts by this share at most.
    spread = share * rows.mean(1)
    exact = np.array(
        [
            (1 - share) * field.entry(int(point), int(pixel))
            for point, pixel in zip(points, pixels, strict=True)
        ]
    )
    exact += spread
    return estimate(rows[here, pixels] - exact, exact, chances[here, pixels])


def estimate(
    differences: npt.NDArray[np.float64],
    values: npt.NDArray[np.float64],
    chances: npt.NDArray[np.float64],
) -> Check:
    """Relative L2 from entries drawn with known chances, and its interval: equation (10).

    Each sum of squares is estimated without bias by the mean of squares over chances (Hansen and
    Hurwitz 1943). The variance of their ratio is that of its residuals, to first order (Cochran,
    Sampling Techniques, 3rd ed., section 6.4). A ratio of squares is skewed: the interval is
    symmetric in its logarithm, by Student's t.

    Args:
        differences: computed minus exact, (entries,).
        values: exact, (entries,).
        chances: chance of each entry, up to a common factor, (entries,).
    """
    count = len(values)
    above, below = differences**2 / chances, values**2 / chances
    if not below.any():
        error = float(bool(above.any()))
        return Check(error, error, error, CONFIDENCE, count)
    ratio = above.mean() / below.mean()
    if not ratio:
        return Check(0.0, 0.0, 0.0, CONFIDENCE, count)
    residuals = above - ratio * below
    deviation = math.sqrt((residuals**2).sum() / (count * (count - 1))) / below.mean()
    # Not from scipy.stats, which takes as long to import as torch.
    quantile = float(stdtrit(count - 1, (1 + _NOMINAL) / 2))
    # Of a root, half the relative deviation.
    factor = math.exp(quantile * deviation / ratio / 2)
    error = math.sqrt(ratio)
    return Check(error, error / factor, error * factor, CONFIDENCE, count)


class FullField:
    """Entries of a mask's transfer with all that interferes, equation (6), one at a time; float64.

    Args:
        model: every effect that is asked for.
        weights: amplitudes asked of the panel.
    """

    def __init__(self, model: Model, weights: Tensor) -> None:
        sampled = model.with_sampling(wavelengths=_WAVELENGTHS, layers=_LAYERS)
        self.model, self.camera = model, actual_camera(model)
        self.beams = [b for b in beams(sampled) if bool(channel_shares(model)[b.channel].any())]
        self.weights = shown(model, weights.detach().double()).numpy()
        self.fade, self.shares = fade(model), channel_shares(model)
        self.tangents = tangents(model)
        self._axes = {
            distance: make_axes(
                model.camera,
                model.scene if distance is None else replace(model.scene, distance=distance),
                model.embedding,
                imperfections=model.conditions.imperfections,
                approximation=replace(model.approximation, shadow=False),
                like=np.empty(0),
            )
            for distance in {beam.scene_distance for beam in self.beams}
        }

    @property
    def values(self) -> float:
        """Field values of one entry."""
        total = 0.0
        for beam in self.beams:
            rows = float(np.count_nonzero(self.camera.row_amplitudes(beam.channel)))
            for axis, apertures in zip(
                self._axes[beam.scene_distance], (rows, self.camera.window.columns), strict=True
            ):
                extent = float(np.ptp(axis.centres)) + float(axis.width)
                fringe = float(beam.wavelength) * self.camera.distance / extent
                total += apertures * node_count(axis.pixel + float(axis.image), fringe)
        return total

    def entry(self, point: int, pixel: int) -> float:
        """Light from scene pixel ``point`` in embedding pixel ``pixel``, both counted by rows."""
        row, column = divmod(point, self.model.scene.columns)
        down, across = divmod(pixel, self.model.embedding.columns)
        rows, columns = self.model.embedding.shape
        tangent_y, tangent_x = self.tangents[0][row], self.tangents[1][column]
        along_y, along_x = (float(factor) for factor in stretch(tangent_y, tangent_x))
        total = 0.0
        for beam in self.beams:
            amplitudes = np.array(self.camera.row_amplitudes(beam.channel))
            passed = np.flatnonzero(amplitudes)
            if not len(passed):
                continue
            axis_y, axis_x = self._axes[beam.scene_distance]
            wavelength = float(beam.wavelength)
            every = np.arange(self.camera.window.columns)
            at_y, at_x = (
                axis_y.at(np.array([row * rows + down]), float(tangent_x**2)),
                axis_x.at(np.array([column * columns + across]), float(tangent_y**2)),
            )
            y = _products(at_y, passed, wavelength * along_y)
            x = _products(at_x, every, wavelength * along_x)
            mask = amplitudes[passed, None] * self.weights[passed]
            # sum over r, s, c, d of y[r, s] w[r, c] w[s, d] x[c, d]
            light = float(((mask.T @ y @ mask) * x).sum().real)
            total += beam.share * float(self.shares[beam.channel, down, across]) * light
        return total * float(self.fade[row, column])


def _products(axis: Axis[Any], of: npt.NDArray[Any], wavelength: float) -> Any:
    """Integrals of products of all aperture fields in the box of one offset, (of, of)."""
    boxes = BoxFields(axis, of, wavelength, len(axis.centres) - 1)
    return boxes.integrated(boxes.fields, boxes.fields)[0]


def _rows(
    operator: LightOperator, weights: Tensor, points: npt.NDArray[np.int64]
) -> npt.NDArray[np.float64]:
    """Return the transfer's rows of some scene pixels, (points, embedding pixels)."""
    scene = operator.model.scene
    lit = torch.zeros(len(points), scene.rows * scene.columns, dtype=operator.dtype)
    lit[torch.arange(len(points)), torch.from_numpy(points)] = 1
    with torch.no_grad():
        response = operator.response(weights)
        values = operator.collect(lit.reshape(-1, *scene.shape), response)
    rows: npt.NDArray[np.float64] = values.flatten(1).double().numpy()
    return rows


def chances_of(
    rows: npt.NDArray[np.float64],
) -> npt.NDArray[np.float64]:
    """Chance of each entry of a row: half evenly, half by its square."""
    squares = rows**2
    sums = squares.sum(1, keepdims=True)
    even = np.full_like(rows, 1 / rows.shape[1])
    bright = np.divide(squares, sums, out=even.copy(), where=sums > 0)
    chances: npt.NDArray[np.float64] = (even + bright) / 2
    return chances
