"""Linear minimum-mean-square-error decoding, prepared once per mask.

With ``A = gain T(w)^T`` the response (embedding pixels, scene pixels), ``mu`` and ``S = B B^T`` the
scene's mean and covariance and ``N`` the diagonal covariance of the noise,

    x^ = mu + S A^T (A S A^T + N)^-1 (v - A mu)            (Kay, Estimation Theory, eq. 12.27)
       = mu + B K (v - A mu),   M = N^(-1/2) A B,
    K  = (I + M^T M)^-1 M^T N^(-1/2) = M^T (I + M M^T)^-1 N^(-1/2),
    cov(x - x^) = B (I + M^T M)^-1 B^T.

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
    """A mu: what the mean scene gives, (E,)."""
    estimator: Array = field(repr=False)
    """K, (rank, E)."""
    noise: Array = field(repr=False)
    """Diagonal of N, (E,)."""
    response: Array = field(repr=False)
    """A B, (E, rank)."""
    mean: Array = field(repr=False)
    """mu, (pixels,)."""
    basis: Array = field(repr=False)
    """B, (pixels, rank)."""
    deviation: Array = field(repr=False)
    """Posterior standard deviation of each scene pixel, (rows, columns)."""
    remaining: float
    """Share of the scene's variance that a measurement leaves unknown, in [0, 1]."""

    def erase(self) -> None:
        """Overwrite all that is the mask's, as well as Python lets us; nothing is decoded any more.

        The mean and the basis are public, and shared with all other decoders.
        """
        overwrite(self.mean_measurement, self.estimator, self.noise, self.response, self.deviation)

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
            measurements: (batch, rows, columns) of the embedding, or (batch, embedding pixels).

        Returns:
            (batch, rows, columns) of the scene, in the units of scenes; not clamped to [0, 1].

        Raises:
            OpticsError: measurements of another shape.
        """
        flat = self.mean + self.coordinates(measurements) @ self.basis.T
        scenes: Array = namespace(flat).reshape(flat, (flat.shape[0], *self.scene.shape))
        return scenes

    def flatten(self, measurements: Array) -> Array:
        """Measurements as (batch, embedding pixels) in the decoder's type; refuse another shape."""
        require(
            tuple(measurements.shape[1:]) in (self.embedding.shape, (self.embedding.size,)),
            "measurements.shape",
            tuple(measurements.shape),
            "",
            f"(batch, *{self.embedding.shape})",
        )
        xp = namespace(measurements)
        flat = xp.reshape(measurements, (measurements.shape[0], self.embedding.size))
        same: Array = xp.astype(flat, self.mean_measurement.dtype, copy=False)
        return same


def prepare_decoder(
    transfer: Array,
    statistics: SceneStatistics[Array],
    noise: MeasurementNoise = DEFAULT_NOISE,
    *,
    scene: Scene,
    embedding: Embedding,
    precision: Precision = Precision.MIXED,
    gain: float | Array = 1.0,
    wanted: SceneStatistics[Array] | None = None,
) -> Decoder[Array]:
    """Prepare a decoder for a transfer matrix; differentiable in it where it is torch's.

    Args:
        transfer: (scene pixels, embedding pixels), of the type of ``precision.products``.
        statistics: statistics of the scenes, of the same type.
        noise: noise to expect in measurements.
        scene: scene whose pixels are estimated; by default those of the matrix.
        embedding: embedding that the matrix gives.
        precision: a dial of accuracy against time.
        gain: measurement per unit of irradiance, a number or one per embedding pixel (E,).
        wanted: statistics of what is to be estimated in the place of the scene, in the same
            coordinates: a linear map of it, such as its means over larger pixels.

    Raises:
        OpticsError: a gain of another shape, or not finite; a transfer that is not finite; what is
            wanted has other coordinates.
    """
    wanted = statistics if wanted is None else wanted
    require(wanted.rank == statistics.rank, "wanted.rank", wanted.rank, "", f"{statistics.rank}")
    xp = namespace(transfer)
    response = transfer.T * _gain(gain, transfer, embedding.size)
    mean_measurement = response @ statistics.mean
    reduced = response @ statistics.basis
    lost = (response * response) @ statistics.residual
    spread = xp.sum(reduced * reduced, axis=1) + lost
    variance = noise.variance(mean_measurement, spread) + lost
    deviation = xp.sqrt(variance)
    scaled = as_type(reduced / deviation[:, None], precision.factors)
    basis = as_type(wanted.basis, precision.factors)
    prior = as_type(wanted.variance, precision.factors)
    if scaled.shape[0] < scaled.shape[1]:
        factor = _factor(scaled @ scaled.T)
        half = solve_triangular(factor, scaled)
        estimator = solve_triangular(factor, half, transposed=True).T
        told = half @ basis.T
        posterior = prior - xp.sum(told * told, axis=0)
    else:
        factor = _factor(scaled.T @ scaled)
        half = solve_triangular(factor, scaled.T)
        estimator = solve_triangular(factor, half, transposed=True)
        left = solve_triangular(factor, basis.T)
        posterior = xp.sum(left * left, axis=0) + as_type(wanted.residual, precision.factors)
    posterior = xp.clip(posterior, 1e-12, None)  # not 0, where the root has no gradient
    total = float(xp.sum(prior))
    decoder = Decoder(
        scene=scene,
        embedding=embedding,
        mean_measurement=mean_measurement,
        estimator=as_type(estimator, precision.products) / deviation,
        noise=variance,
        response=reduced,
        mean=wanted.mean,
        basis=wanted.basis,
        deviation=xp.reshape(as_type(xp.sqrt(posterior), precision.products), scene.shape),
        remaining=float(xp.sum(detached(posterior))) / total if total > 0 else 0.0,
    )
    if not needs_gradient(response):
        overwrite(response, scaled, factor, half, estimator)
    return decoder


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
        """Transfer matrix (scene pixels, embedding pixels) of a mask."""


OperatorT = TypeVar("OperatorT", bound=Operator, default="TransferOperator")


class SceneDecoding(Generic[OperatorT]):
    """Prepares decoders: all that does not depend on the mask, made once.

    Args:
        operator: gray transfer operator of the camera; its type is set by ``precision``.
        statistics: statistics of the scenes; their rank is a dial of accuracy against time.
        noise: noise to expect in measurements.
        precision: a dial of accuracy against time.

    Raises:
        OpticsError: a colour operator, an operator of another type than ``precision`` wants, or
            statistics of another scene.
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
        if operator.colour:
            raise OpticsError("a colour operator cannot be decoded: use colour=False")
        require(
            statistics.pixels == scene.rows * scene.columns,
            "statistics.pixels",
            statistics.pixels,
            "pixels",
            f"the scene's, {scene.shape}",
        )
        self.statistics: SceneStatistics[Any] = statistics.to(precision.products)
        require_choice("operator's dtype", operator.dtype, [self.statistics.mean.dtype])
        self.operator, self.noise, self.precision = operator, noise, precision

    def prepare(self, weights: Array, *, gain: float | Array = 1.0) -> Decoder[Array]:
        """Prepare the decoder of one mask; differentiable in the weights.

        Args:
            weights: amplitude transmittances as the panel shows them (quantised, with dead rows),
                ``camera.mask_shape``.
            gain: measurement per unit of irradiance, a number or one per embedding pixel (E,).

        Raises:
            OpticsError: a mask or gain of another shape, or not finite.
        """
        transfer: Array = self.operator(as_type(weights, self.precision.products))
        decoder = self.prepare_transfer(transfer, gain=gain)
        if not needs_gradient(transfer):  # it needs the matrix still
            overwrite(transfer)
        return decoder

    def prepare_transfer(self, transfer: Array, *, gain: float | Array = 1.0) -> Decoder[Array]:
        """Prepare the decoder of a transfer matrix (scene pixels, embedding pixels)."""
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
    """Return a number, or a column (E, 1) in the place and of the type of ``transfer``."""
    if isinstance(gain, int | float):
        if not (math.isfinite(gain) and gain > 0):
            raise OpticsError("gain is not valid: use finite numbers > 0")
        return gain
    xp = namespace(transfer)
    shape = tuple(gain.shape)
    require(shape in ((), (size,)), "gain.shape", shape, "", f"one number, or ({size},)")
    if not bool(xp.all(xp.isfinite(gain) & (gain > 0))):
        raise OpticsError("gain is not valid: use finite numbers > 0")
    values = xp.astype(to_device(gain, device(transfer)), transfer.dtype, copy=False)
    column: Array = xp.reshape(values, (-1, 1))
    return column


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
