"""Mean and covariance of the scenes that a camera looks at: public, and all that decoding needs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, Self

from veilcam_optics.arrays import Array, as_numpy, as_type, device, namespace
from veilcam_optics.errors import OpticsError, invalid, require, require_count, require_shape

if TYPE_CHECKING:
    import numpy.typing as npt
    from torch import Tensor


@dataclass(frozen=True)
class SceneStatistics(Generic[Array]):
    """Scenes have mean ``mean`` and covariance ``basis basis^T + diag(residual)``.

    The basis holds the strongest principal components, each times its standard deviation and
    ordered by it; the residual is what they leave of each pixel's variance. Pixels in row order.
    In colour each has three values, and all of R come before those of G and B.
    """

    mean: Array = field(repr=False)
    """(pixels,)."""
    basis: Array = field(repr=False)
    """(pixels, rank)."""
    residual: Array = field(repr=False)
    """(pixels,), not negative."""

    def __post_init__(self) -> None:
        pixels = self.mean.shape[0] if self.mean.ndim == 1 else 0
        require(pixels != 0, "statistics.mean.shape", tuple(self.mean.shape), "", "(pixels,)")
        require(
            self.basis.ndim == 2 and self.basis.shape[0] == pixels and self.basis.shape[1] >= 1,
            "statistics.basis.shape",
            tuple(self.basis.shape),
            "",
            f"({pixels}, 1 or more)",
        )
        require_shape("statistics.residual", self.residual, pixels)
        xp = namespace(self.mean)
        if not all(bool(xp.all(xp.isfinite(t))) for t in self._all):
            raise OpticsError("statistics hold NaN or infinity: make them again")
        if bool(xp.any(self.residual < 0)):
            raise OpticsError("statistics.residual holds a negative variance: make them again")

    @property
    def pixels(self) -> int:
        """Number of values of a scene: its pixels, or three times as many in colour."""
        return int(self.mean.shape[0])

    @property
    def rank(self) -> int:
        """Number of principal components that are kept."""
        return int(self.basis.shape[1])

    @property
    def variance(self) -> Array:
        """Variance of each pixel, (pixels,)."""
        variance: Array = _squares(self.basis) + self.residual
        return variance

    @property
    def share(self) -> float:
        """Share of the total variance that the basis holds, in [0, 1]; 1 if nothing varies."""
        xp = namespace(self.basis)
        total = float(xp.sum(self.variance))
        return float(xp.sum(_squares(self.basis))) / total if total > 0 else 1.0

    def truncate(self, rank: int) -> Self:
        """Keep the ``rank`` strongest components; the others' variance goes to the residual."""
        require(1 <= rank <= self.rank, "rank", rank, "", f"1 to {self.rank}, as many as there are")
        dropped = _squares(self.basis[:, rank:])
        return type(self)(self.mean, self.basis[:, :rank], self.residual + dropped)

    def to(self, name: str) -> Self:
        """Return the same statistics as ``float32`` or ``float64``."""
        return type(self)(*(as_type(each, name) for each in self._all))

    def in_numpy(self) -> SceneStatistics[npt.NDArray[Any]]:
        """Return the same statistics in NumPy, for a device."""
        return SceneStatistics(*(as_numpy(each) for each in self._all))

    def in_torch(self) -> SceneStatistics[Tensor]:
        """Return the same statistics in torch, for training."""
        import torch  # noqa: PLC0415 - who asks for it has it

        return SceneStatistics(*(torch.as_tensor(each) for each in self._all))

    @property
    def _all(self) -> tuple[Array, Array, Array]:
        return self.mean, self.basis, self.residual


def fit_statistics(batches: Iterable[Array], rank: int) -> SceneStatistics[Array]:
    """Mean and principal components of scenes, in float64.

    Args:
        batches: scenes (count, rows, columns), (count, 3, rows, columns) or (count, pixels), batch
            by batch; all are needed only once and one at a time.
        rank: components to keep; no more are kept than there are pixels.

    Raises:
        OpticsError: fewer than two scenes, or batches that differ in shape.
    """
    require_count("rank", rank)
    count, origin, first, second = 0, None, None, None
    for batch in batches:
        xp = namespace(batch)
        flat = as_type(xp.reshape(batch, (batch.shape[0], -1)), "float64")
        if origin is None:
            # Sums of squares about a point near the mean lose no digits to cancellation.
            origin = xp.mean(flat, axis=0)
            pixels = origin.shape[0]
            first = xp.zeros_like(origin)
            second = xp.zeros((pixels, pixels), dtype=origin.dtype, device=device(origin))
        require(
            flat.shape[1] == origin.shape[0],
            "scenes.shape",
            tuple(batch.shape),
            "",
            f"{origin.shape[0]} pixels each",
        )
        offset = flat - origin
        count += flat.shape[0]
        first += xp.sum(offset, axis=0)
        second += offset.T @ offset
    if count < 2 or origin is None or first is None or second is None:
        raise invalid("scenes", count, "scenes", "at least two")
    xp = namespace(origin)
    shift = first / count
    covariance = second / count - shift[:, None] * shift
    values, vectors = xp.linalg.eigh(covariance)
    rank = min(rank, values.shape[0])
    kept = xp.clip(xp.flip(values[-rank:]), 0, None)
    basis = xp.flip(vectors[:, -rank:], axis=1) * xp.sqrt(kept)
    residual = xp.clip(xp.linalg.diagonal(covariance) - _squares(basis), 0, None)
    return SceneStatistics(origin + shift, basis, residual).to("float32")


def _squares(basis: Array) -> Array:
    """Sum of the squares of each row: what the components add to a pixel's variance."""
    squares: Array = namespace(basis).sum(basis * basis, axis=1)
    return squares
