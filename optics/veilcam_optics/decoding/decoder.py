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

from dataclasses import dataclass, field
from enum import Enum

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Embedding, Scene
from veilcam_optics.decoding.noise import DEFAULT_NOISE, MeasurementNoise
from veilcam_optics.decoding.statistics import SceneStatistics
from veilcam_optics.errors import OpticsError, require, require_choice
from veilcam_optics.transfer.operator import TransferOperator


class Precision(Enum):
    """Type of the products with the transfer matrix, and type of the Cholesky factor."""

    SINGLE = (torch.float32, torch.float32)
    MIXED = (torch.float32, torch.float64)
    DOUBLE = (torch.float64, torch.float64)

    @property
    def products(self) -> torch.dtype:
        """Type of transfer matrix, measurements and estimates."""
        return self.value[0]

    @property
    def factors(self) -> torch.dtype:
        """Type of the matrix that is factored."""
        return self.value[1]


@dataclass(frozen=True)
class Decoder:
    """Decodes measurements behind one mask; as secret as the mask, so its repr holds nothing.

    Made by :meth:`SceneDecoding.prepare`.
    """

    scene: Scene
    embedding: Embedding
    mean_measurement: Tensor = field(repr=False)
    """A mu: what the mean scene gives, (E,)."""
    estimator: Tensor = field(repr=False)
    """K, (rank, E)."""
    noise: Tensor = field(repr=False)
    """Diagonal of N, (E,)."""
    response: Tensor = field(repr=False)
    """A B, (E, rank)."""
    mean: Tensor = field(repr=False)
    """mu, (pixels,)."""
    basis: Tensor = field(repr=False)
    """B, (pixels, rank)."""
    deviation: Tensor = field(repr=False)
    """Posterior standard deviation of each scene pixel, (rows, columns)."""
    remaining: float
    """Share of the scene's variance that a measurement leaves unknown, in [0, 1]."""

    def erase(self) -> None:
        """Overwrite all that is the mask's, as well as Python lets us; nothing is decoded any more.

        The mean and the basis are public, and shared with all other decoders.
        """
        overwrite(self.mean_measurement, self.estimator, self.noise, self.response, self.deviation)

    def coordinates(self, measurements: Tensor) -> Tensor:
        """Estimates as coordinates in the scene's basis, (batch, rank)."""
        flat = self.flatten(measurements)
        return (flat - self.mean_measurement) @ self.estimator.T

    def __call__(self, measurements: Tensor) -> Tensor:
        """Estimate scenes.

        Args:
            measurements: (batch, rows, columns) of the embedding, or (batch, embedding pixels).

        Returns:
            (batch, rows, columns) of the scene, in the units of scenes; not clamped to [0, 1].

        Raises:
            OpticsError: measurements of another shape.
        """
        flat = torch.addmm(self.mean, self.coordinates(measurements), self.basis.T)
        return flat.reshape(-1, *self.scene.shape)

    def flatten(self, measurements: Tensor) -> Tensor:
        """Measurements as (batch, embedding pixels) in the decoder's type; refuse another shape."""
        require(
            tuple(measurements.shape[1:]) in (self.embedding.shape, (self.embedding.size,)),
            "measurements.shape",
            tuple(measurements.shape),
            "",
            f"(batch, *{self.embedding.shape})",
        )
        return measurements.flatten(1).to(self.mean_measurement.dtype)


class SceneDecoding:
    """Prepares decoders: all that does not depend on the mask, made once.

    Args:
        operator: gray transfer operator of the camera; its type is set by ``precision``.
        statistics: of the scenes; their rank is a dial of accuracy against time.
        noise: to expect in measurements.
        precision: a dial of accuracy against time.

    Raises:
        OpticsError: a colour operator, an operator of another type than ``precision`` wants, or
            statistics of another scene.
    """

    def __init__(
        self,
        operator: TransferOperator,
        statistics: SceneStatistics,
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
        dtype = next(operator.buffers()).dtype
        require_choice("operator's dtype", dtype, [precision.products])
        self.operator, self.noise, self.precision = operator, noise, precision
        self.statistics = statistics.to(precision.products)

    def prepare(self, weights: Tensor, *, gain: float | Tensor = 1.0) -> Decoder:
        """Decoder for one mask; differentiable in the weights.

        Args:
            weights: amplitude transmittances as the panel shows them (quantised, with dead rows),
                ``camera.mask_shape``.
            gain: measurement per unit of irradiance, a number or one per embedding pixel (E,).

        Raises:
            OpticsError: a mask or gain of another shape, or not finite.
        """
        transfer: Tensor = self.operator(weights.to(self.precision.products))
        decoder = self.prepare_transfer(transfer, gain=gain)
        if not transfer.requires_grad:  # a gradient needs it still
            overwrite(transfer)
        return decoder

    def prepare_transfer(self, transfer: Tensor, *, gain: float | Tensor = 1.0) -> Decoder:
        """Decoder for a transfer matrix (scene pixels, embedding pixels), e.g. a measured one."""
        operator, statistics, factors = self.operator, self.statistics, self.precision.factors
        response = transfer.T * self._gain(gain, transfer.device)
        mean_measurement = response @ statistics.mean
        reduced = response @ statistics.basis
        lost = response.square() @ statistics.residual
        spread = reduced.square().sum(1) + lost
        noise = self.noise.variance(mean_measurement, spread) + lost
        scaled = (reduced * noise.rsqrt()[:, None]).to(factors)
        basis, prior = statistics.basis.to(factors), statistics.variance.to(factors)
        if scaled.shape[0] < scaled.shape[1]:
            factor = _cholesky(scaled @ scaled.T)
            estimator = torch.cholesky_solve(scaled, factor).T
            known = torch.linalg.solve_triangular(factor, scaled @ basis.T, upper=False)
            variance = prior - known.square().sum(0)
        else:
            factor = _cholesky(scaled.T @ scaled)
            estimator = torch.cholesky_solve(scaled.T, factor)
            left = torch.linalg.solve_triangular(factor, basis.T, upper=False)
            variance = left.square().sum(0) + statistics.residual
        variance = variance.clamp_min(1e-12)  # not 0, where the root has no gradient
        total = float(prior.sum())
        products = self.precision.products
        decoder = Decoder(
            scene=operator.scene,
            embedding=operator.embedding,
            mean_measurement=mean_measurement,
            estimator=estimator.to(products) * noise.rsqrt(),
            noise=noise,
            response=reduced,
            mean=statistics.mean,
            basis=statistics.basis,
            deviation=variance.sqrt().to(products).reshape(operator.scene.shape),
            remaining=float(variance.detach().sum()) / total if total > 0 else 0.0,
        )
        if not response.requires_grad:
            overwrite(response, scaled, factor, estimator)
        return decoder

    def _gain(self, gain: float | Tensor, device: torch.device) -> Tensor:
        value = torch.as_tensor(gain, dtype=self.precision.products, device=device)
        size = self.operator.embedding.size
        require(
            tuple(value.shape) in ((), (size,)),
            "gain.shape",
            tuple(value.shape),
            "",
            f"one number, or ({size},)",
        )
        if not bool((value.isfinite() & (value > 0)).all()):
            raise OpticsError("gain is not valid: use finite numbers > 0")
        return value.reshape(-1, 1)


def overwrite(*tensors: Tensor) -> None:
    """Fill tensors with zeros, whatever mode they were made in; copies elsewhere stay."""
    with torch.inference_mode():
        for tensor in tensors:
            tensor.zero_()


def _cholesky(gram: Tensor) -> Tensor:
    """Lower factor of I + gram, with the module's jitter on the diagonal."""
    identity = torch.eye(len(gram), dtype=gram.dtype, device=gram.device)
    jitter = torch.finfo(gram.dtype).eps * (1 + gram.detach().diagonal().max())
    while True:
        factor: Tensor
        factor, failure = torch.linalg.cholesky_ex(gram + (1 + jitter) * identity)
        if not int(failure):
            return factor
        if not bool(jitter < gram.detach().diagonal().max()):
            raise OpticsError("the response cannot be decoded: it holds NaN or infinity")
        jitter = 10 * jitter
