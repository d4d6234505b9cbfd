"""Linear minimum-mean-square-error decoding, prepared once per mask.

With ``A = gain T(w)^T`` the response (embedding values, scene values), ``mu`` and ``S = B B^T`` the
scene's mean and covariance and ``N`` the diagonal covariance of the noise,

    x^ = mu + S A^T (A S A^T + N)^-1 (v - A mu)            (Kay, Estimation Theory, eq. 12.27)
       = mu + B K (v - A mu),   M = N^(-1/2) A B,
    K  = (I + M^T M)^-1 M^T N^(-1/2) = M^T (I + M M^T)^-1 N^(-1/2),
    cov(x - x^) = B (I + M^T M)^-1 B^T.

A scene in colour has the values of R, then those of G, then those of B. So has its embedding, and A
holds a block for each colour: what one colour tells of another is in S.

The two forms of K are equal (Woodbury); the smaller matrix is the one factored. What the basis
leaves of the scene's variance acts as noise: ``diag(A diag(residual) A^T)`` is added to N.

Jitter: both matrices have eigenvalues of at least 1, so in exact arithmetic none is needed. In
floating point with unit roundoff u, rounding moves them by about u times the largest diagonal
entry; that is what is added to the diagonal, and ten times more after every failure. In float64 it
is below 1e-8. In float32 it is not small beside 1, which is why float32 is an option and mixed
precision (products in float32, factors in float64) the default.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any, Generic, Protocol

import numpy as np
from typing_extensions import TypeVar

from veilcam_optics.arrays import (
    Array,
    as_type,
    cholesky,
    detached,
    device,
    namespace,
    needs_gradient,
    overwrite,
    solve_triangular,
    to_device,
)
from veilcam_optics.camera.geometry import Embedding, Scene
from veilcam_optics.decoding.noise import DEFAULT_NOISE, MeasurementNoise
from veilcam_optics.decoding.statistics import SceneStatistics
from veilcam_optics.errors import OpticsError, require, require_choice

if TYPE_CHECKING:
    from veilcam_optics.transfer.operator import TransferOperator


class Precision(Enum):
    """Type of the products with the transfer matrix, and type of the Cholesky factor."""

    SINGLE = ("float32", "float32")
    MIXED = ("float32", "float64")
    DOUBLE = ("float64", "float64")

    @property
    def products(self) -> str:
        """Type of transfer matrix, measurements and estimates."""
        return self.value[0]

    @property
    def factors(self) -> str:
        """Type of the matrix that is factored."""
        return self.value[1]


@dataclass(frozen=True)
class Decoder(Generic[Array]):
    """Decodes measurements behind one mask; as secret as the mask, so its repr holds nothing.

    Made by :meth:`SceneDecoding.prepare`.
    """

    scene: Scene
    embedding: Embedding
    mean_measurement: Array = field(repr=False)
    """A mu: what the mean scene gives, (E,): the embedding's values, three times as many in
    colour."""
    estimator: Array = field(repr=False)
    """K, (rank, E)."""
    noise: Array = field(repr=False)
    """Diagonal of N, (E,)."""
    response: Array = field(repr=False)
    """A B, (E, rank)."""
    mean: Array = field(repr=False)
    """mu, (scene values,)."""
    basis: Array = field(repr=False)
    """B, (scene values, rank)."""

    @property
    def channels(self) -> int:
        """1 gray, 3 in colour."""
        return int(self.mean_measurement.shape[0]) // self.embedding.size

    def erase(self) -> None:
        """Overwrite all that is the mask's, as well as Python lets us; nothing is decoded any more.

        The mean and the basis are public, and shared with all other decoders.
        """
        overwrite(self.mean_measurement, self.estimator, self.noise, self.response)

    def coordinates(self, measurements: Array) -> Array:
        """Estimates as coordinates in the scene's basis, (batch, rank)."""
        flat = self.flatten(measurements)
        coordinates: Array = (flat - self.mean_measurement) @ self.estimator.T
        return coordinates

    def innovation(self, measurements: Array) -> Array:
        """Normalised squares of the innovation, over their number.

        It is 1 in the mean where scenes and noise are as they are expected to be, and more where
        they are not.

            nis = (v - A mu)^T (A S A^T + N)^-1 (v - A mu) / E
                = (v - A mu)^T N^-1 (v - A mu - A B z) / E,    z = K (v - A mu)

        (Bar-Shalom, Estimation with Applications to Tracking and Navigation, eq. 5.4.2-9.)

        Args:
            measurements: measurements as for :meth:`__call__`.

        Returns:
            (batch,), not negative.

        Raises:
            OpticsError: measurements of another shape.
        """
        xp = namespace(measurements)
        told = self.flatten(measurements) - self.mean_measurement
        left = told - (told @ self.estimator.T) @ self.response.T
        squares: Array = xp.clip(xp.mean(told * left / self.noise, axis=1), 0, None)
        return squares

    def novelty(self, measurements: Array) -> Array:
        """Root of the innovation over the light, that of the mean scene being 1.

        How far a scene is from those to be expected, whatever its brightness; huge without light.

        Args:
            measurements: measurements as for :meth:`__call__`.

        Returns:
            (batch,), not negative.

        Raises:
            OpticsError: measurements of another shape.
        """
        xp = namespace(measurements)
        light = xp.sum(self.flatten(measurements), axis=1) / xp.sum(self.mean_measurement)
        root = xp.sqrt(self.innovation(measurements))
        with np.errstate(over="ignore"):  # without light; torch says nothing
            far: Array = root / xp.clip(light, float(xp.finfo(light.dtype).tiny), None)
        return far

    def __call__(self, measurements: Array) -> Array:
        """Estimate scenes.

        Args:
            measurements: (batch, rows, columns) of the embedding, (batch, 3, rows, columns) in
                colour, or (batch, E).

        Returns:
            (batch, rows, columns) or (batch, 3, rows, columns) of the scene, in the units of
            scenes; not clamped to [0, 1].

        Raises:
            OpticsError: measurements of another shape.
        """
        flat = self.mean + self.coordinates(measurements) @ self.basis.T
        shape: tuple[int, ...] = self._planes(self.scene.shape)
        scenes: Array = namespace(flat).reshape(flat, (flat.shape[0], *shape))
        return scenes

    def flatten(self, measurements: Array) -> Array:
        """Measurements as (batch, E) in the decoder's type; refuse another shape."""
        shape, size = self._planes(self.embedding.shape), self.mean_measurement.shape[0]
        require(
            tuple(measurements.shape[1:]) in (shape, (size,)),
            "measurements.shape",
            tuple(measurements.shape),
            "",
            f"(batch, *{shape})",
        )
        xp = namespace(measurements)
        flat = xp.reshape(measurements, (measurements.shape[0], size))
        same: Array = xp.astype(flat, self.mean_measurement.dtype, copy=False)
        return same

    def _planes(self, shape: tuple[int, int]) -> tuple[int, ...]:
        return shape if self.channels == 1 else (self.channels, *shape)


def prepare_decoder(
    transfer: Array,
    statistics: SceneStatistics[Array],
    noise: MeasurementNoise = DEFAULT_NOISE,
    *,
    scene: Scene,
    embedding: Embedding,
    precision: Precision = Precision.MIXED,
    gain: float | Array = 1.0,
) -> Decoder[Array]:
    """Prepare a decoder for a transfer matrix; differentiable in it where it is torch's.

    Args:
        transfer: (scene pixels, embedding pixels), or three of them in colour; of the type of
            ``precision.products``.
        statistics: statistics of the scenes, of the same type.
        noise: noise to expect in measurements.
        scene: scene whose pixels are estimated.
        embedding: embedding that the matrix gives.
        precision: a dial of accuracy against time.
        gain: measurement per unit of irradiance, a number or one per embedding value (E,).

    Raises:
        OpticsError: a gain of another shape, or not finite; a transfer that is not finite.
    """
    expected = _expect(transfer, statistics, noise, gain)
    scaled = as_type(expected.scaled, precision.factors)
    if scaled.shape[0] < scaled.shape[1]:
        factor = _factor(scaled @ scaled.T)
        half = solve_triangular(factor, scaled)
        estimator = solve_triangular(factor, half, transposed=True).T
    else:
        factor = _factor(scaled.T @ scaled)
        half = solve_triangular(factor, scaled.T)
        estimator = solve_triangular(factor, half, transposed=True)
    decoder = Decoder(
        scene=scene,
        embedding=embedding,
        mean_measurement=expected.mean,
        estimator=as_type(estimator, precision.products) / expected.deviation,
        noise=expected.variance,
        response=expected.response,
        mean=statistics.mean,
        basis=statistics.basis,
    )
    if not needs_gradient(transfer):
        overwrite(scaled, factor, half, estimator, expected.deviation)
    return decoder


def unknown_share(
    transfer: Array, statistics: SceneStatistics[Array], noise: MeasurementNoise = DEFAULT_NOISE
) -> Array:
    """Share of the scenes' variance that a measurement leaves unknown, in [0, 1].

    It depends on the mask and on public statistics alone: no scene and no label has a part in it.
    It is differentiable in the transfer where that is torch's, and computed in float64.

    Args:
        transfer: transfer as for :func:`prepare_decoder`.
        statistics: statistics of the scenes. Their basis holds principal components.
        noise: noise to expect in measurements.

    Returns:
        A scalar array.

    Raises:
        OpticsError: a transfer that is not finite.
    """
    xp = namespace(transfer)
    scaled = as_type(_expect(transfer, statistics, noise, 1.0).scaled, "float64")
    basis = as_type(statistics.basis, "float64")
    powers = xp.sum(basis * basis, axis=0)
    lost = xp.sum(as_type(statistics.residual, "float64"))
    total = xp.sum(powers) + lost
    total = xp.clip(total, float(xp.finfo(total.dtype).tiny), None)  # scenes that never change
    if scaled.shape[0] < scaled.shape[1]:
        half = solve_triangular(_factor(scaled @ scaled.T), scaled)
        told = xp.sum(half * half, axis=0) * powers
        share: Array = (xp.sum(powers - told) + lost) / total
    else:
        roots = xp.eye(powers.shape[0], dtype=powers.dtype, device=device(powers)) * xp.sqrt(powers)
        left = solve_triangular(_factor(scaled.T @ scaled), roots)
        share = (xp.sum(left * left) + lost) / total
    return share


@dataclass(frozen=True, slots=True)
class _Expected(Generic[Array]):
    """Measurements to expect: mean, noise, and their response to the scenes' components."""

    mean: Array
    """(E,)."""
    response: Array
    """A B, (E, rank)."""
    variance: Array
    """Of the noise, (E,)."""
    deviation: Array
    """(E,)."""

    @property
    def scaled(self) -> Array:
        """M, (E, rank)."""
        scaled: Array = self.response / self.deviation[:, None]
        return scaled


def _expect(
    transfer: Array,
    statistics: SceneStatistics[Array],
    noise: MeasurementNoise,
    gain: float | Array,
) -> _Expected[Array]:
    """Return what to expect of measurements behind a mask.

    No colour of the scene reaches another colour of the embedding.
    """
    xp = namespace(transfer)
    planes = [transfer] if transfer.ndim == 2 else [transfer[channel] for channel in range(3)]
    pixels, size = planes[0].shape
    values = len(planes) * pixels
    require(statistics.pixels == values, "statistics.pixels", statistics.pixels, "", f"{values}")
    factor = _gain(gain, transfer, len(planes) * size)
    means, responses, residues = [], [], []
    for channel, plane in enumerate(planes):
        here = slice(channel * pixels, (channel + 1) * pixels)
        means.append(plane.T @ statistics.mean[here])
        responses.append(plane.T @ statistics.basis[here])
        residues.append((plane * plane).T @ statistics.residual[here])
    mean = xp.concat(means) * factor
    response = xp.concat(responses) * (factor if isinstance(factor, float) else factor[:, None])
    lost = xp.concat(residues) * factor**2
    spread = xp.sum(response * response, axis=1) + lost
    variance = noise.variance(mean, spread) + lost
    return _Expected(mean, response, variance, xp.sqrt(variance))


class Operator(Protocol):
    """Operator that gives the transfer matrix of a mask: in NumPy or, as a module, in torch."""

    @property
    def scene(self) -> Scene:
        """Scene whose pixels the matrix takes."""

    @property
    def embedding(self) -> Embedding:
        """Embedding whose pixels the matrix gives."""

    @property
    def colour(self) -> bool:
        """True where it gives three matrices."""

    @property
    def dtype(self) -> Any:
        """Type of the matrix."""

    def __call__(self, weights: Any, /) -> Any:
        """Transfer matrix (scene pixels, embedding pixels) of a mask, or three in colour."""


OperatorT = TypeVar("OperatorT", bound=Operator, default="TransferOperator")


class SceneDecoding(Generic[OperatorT]):
    """Prepares decoders: all that does not depend on the mask, made once.

    Args:
        operator: transfer operator of the camera; its type is set by ``precision``.
        statistics: statistics of the scenes; their rank is a dial of accuracy against time.
        noise: noise to expect in measurements.
        precision: a dial of accuracy against time.

    Raises:
        OpticsError: an operator of another type than ``precision`` wants, or statistics of another
            scene.
    """

    def __init__(
        self,
        operator: OperatorT,
        statistics: SceneStatistics[Array],
        noise: MeasurementNoise = DEFAULT_NOISE,
        *,
        precision: Precision = Precision.MIXED,
    ) -> None:
        scene = operator.scene
        require(
            statistics.pixels == (3 if operator.colour else 1) * scene.rows * scene.columns,
            "statistics.pixels",
            statistics.pixels,
            "pixels",
            f"the scene's, {scene.shape}" + (" in three colours" if operator.colour else ""),
        )
        self.statistics: SceneStatistics[Any] = statistics.to(precision.products)
        require_choice("operator's dtype", operator.dtype, [self.statistics.mean.dtype])
        self.operator, self.noise, self.precision = operator, noise, precision

    def prepare(self, weights: Array, *, gain: float | Array = 1.0) -> Decoder[Array]:
        """Prepare the decoder of one mask; differentiable in the weights.

        Args:
            weights: amplitude transmittances as the panel shows them (quantised, with dead rows),
                ``camera.mask_shape``.
            gain: measurement per unit of irradiance, a number or one per embedding value (E,).

        Raises:
            OpticsError: a mask or gain of another shape, or not finite.
        """
        transfer: Array = self.operator(as_type(weights, self.precision.products))
        decoder = self.prepare_transfer(transfer, gain=gain)
        if not needs_gradient(transfer):  # it needs the matrix still
            overwrite(transfer)
        return decoder

    def prepare_transfer(self, transfer: Array, *, gain: float | Array = 1.0) -> Decoder[Array]:
        """Prepare the decoder of a transfer: (scene pixels, embedding pixels), three in colour."""
        decoder: Decoder[Array] = prepare_decoder(
            transfer,
            self.statistics,
            self.noise,
            scene=self.operator.scene,
            embedding=self.operator.embedding,
            precision=self.precision,
            gain=gain,
        )
        return decoder


def _gain(gain: float | Array, transfer: Array, size: int) -> Any:
    """Return a float, or numbers (E,) in the place and of the type of ``transfer``."""
    if isinstance(gain, int | float):
        if not (math.isfinite(gain) and gain > 0):
            raise OpticsError("gain is not valid: use finite numbers > 0")
        return float(gain)
    xp = namespace(transfer)
    shape = tuple(gain.shape)
    require(shape in ((), (size,)), "gain.shape", shape, "", f"one number, or ({size},)")
    if not bool(xp.all(xp.isfinite(gain) & (gain > 0))):
        raise OpticsError("gain is not valid: use finite numbers > 0")
    values: Array = xp.astype(to_device(gain, device(transfer)), transfer.dtype, copy=False)
    return xp.broadcast_to(values, (size,))


def _factor(gram: Array) -> Array:
    """Lower factor of I + gram, with the module's jitter on the diagonal."""
    xp = namespace(gram)
    identity = xp.eye(gram.shape[0], dtype=gram.dtype, device=device(gram))
    largest = float(xp.max(xp.linalg.diagonal(detached(gram))))
    jitter = float(xp.finfo(gram.dtype).eps) * (1 + largest)
    while True:
        factor: Array | None = cholesky(gram + (1 + jitter) * identity)
        if factor is not None:
            return factor
        if not jitter < largest:
            raise OpticsError("the response cannot be decoded: it holds NaN or infinity")
        jitter = 10 * jitter
