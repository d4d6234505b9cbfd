"""Mean and covariance of the scenes that a camera looks at: public, and all that decoding needs."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Self

import torch
from torch import Tensor

from veilcam_optics.errors import OpticsError, invalid, require, require_count, require_shape


@dataclass(frozen=True)
class SceneStatistics:
    """Scenes have mean ``mean`` and covariance ``basis basis^T + diag(residual)``.

    The basis holds the strongest principal components, each times its standard deviation and
    ordered by it; the residual is what they leave of each pixel's variance. Pixels in row order.
    """

    mean: Tensor = field(repr=False)
    """(pixels,)."""
    basis: Tensor = field(repr=False)
    """(pixels, rank)."""
    residual: Tensor = field(repr=False)
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
        if not all(bool(t.isfinite().all()) for t in (self.mean, self.basis, self.residual)):
            raise OpticsError("statistics hold NaN or infinity: make them again")
        if bool((self.residual < 0).any()):
            raise OpticsError("statistics.residual holds a negative variance: make them again")

    @property
    def pixels(self) -> int:
        """How many pixels a scene has."""
        return int(self.mean.shape[0])

    @property
    def rank(self) -> int:
        """How many principal components are kept."""
        return int(self.basis.shape[1])

    @property
    def variance(self) -> Tensor:
        """Variance of each pixel, (pixels,)."""
        return self.basis.square().sum(1) + self.residual

    @property
    def share(self) -> float:
        """Share of the total variance that the basis holds, in [0, 1]; 1 if nothing varies."""
        total = float(self.variance.sum())
        return float(self.basis.square().sum()) / total if total > 0 else 1.0

    def truncate(self, rank: int) -> Self:
        """The ``rank`` strongest components alone; the others' variance goes to the residual."""
        require(1 <= rank <= self.rank, "rank", rank, "", f"1 to {self.rank}, as many as there are")
        dropped = self.basis[:, rank:].square().sum(1)
        return type(self)(self.mean, self.basis[:, :rank], self.residual + dropped)

    def to(self, dtype: torch.dtype) -> Self:
        """The same in another precision."""
        return type(self)(self.mean.to(dtype), self.basis.to(dtype), self.residual.to(dtype))


def fit_statistics(batches: Iterable[Tensor], rank: int) -> SceneStatistics:
    """Mean and principal components of scenes, in float64.

    Args:
        batches: scenes (count, rows, columns), or (count, pixels), batch by batch; all are needed
            only once and one at a time.
        rank: components to keep; no more are kept than there are pixels.

    Raises:
        OpticsError: fewer than two scenes, or batches that differ in shape.
    """
    require_count("rank", rank)
    count, origin, first, second = 0, None, None, None
    for batch in batches:
        flat = batch.reshape(len(batch), -1).double()
        if origin is None:
            # Sums of squares about a point near the mean lose no digits to cancellation.
            origin = flat.mean(0)
            first = torch.zeros_like(origin)
            second = origin.new_zeros(len(origin), len(origin))
        assert first is not None and second is not None  # noqa: S101, PT018
        require(
            flat.shape[1] == len(origin),
            "scenes.shape",
            tuple(batch.shape),
            "",
            f"{len(origin)} pixels each",
        )
        offset = flat - origin
        count += len(flat)
        first += offset.sum(0)
        second += offset.T @ offset
    if count < 2 or origin is None or first is None or second is None:
        raise invalid("scenes", count, "scenes", "at least two")
    shift = first / count
    covariance = second / count - torch.outer(shift, shift)
    values, vectors = torch.linalg.eigh(covariance)
    rank = min(rank, len(values))
    kept = values[-rank:].flip(0).clamp_min(0)
    basis = vectors[:, -rank:].flip(1) * kept.sqrt()
    residual = (covariance.diagonal() - basis.square().sum(1)).clamp_min(0)
    return SceneStatistics((origin + shift).float(), basis.float(), residual.float())
