"""The transfer operator of torch: from a mask straight to the matrix from scene to embedding."""

from collections.abc import Callable, Sequence
from typing import Self

import torch
from torch import Tensor, nn

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.transfer.kernels import EXACT, Approximation
from veilcam_optics.transfer.product import Transfer
from veilcam_optics.transfer.regions import Region
from veilcam_optics.transfer.tables import (
    NEIGHBOURS,
    NO_VARIABLES,
    Beam,
    Reach,
    Variables,
    make_transfer,
)


class TransferOperator(nn.Module):
    """``T(w)`` for one camera, scene and embedding; everything but ``w`` is computed once.

    A module of torch, whose buffers are the tables; what computes is :class:`Transfer`, which does
    so in NumPy just as well.

    Args:
        dtype: type of the result.

    All other arguments, and what is raised, are those of :func:`make_transfer`.
    """

    def __init__(
        self,
        camera: Camera,
        scene: Scene,
        embedding: Embedding,
        *,
        reach: Reach = NEIGHBOURS,
        step: float = 1.55e-6,
        colour: bool = False,
        dtype: torch.dtype = torch.float32,
        variables: Variables = NO_VARIABLES,
        beams: Sequence[Beam] | None = None,
        approximation: Approximation = EXACT,
        centre: tuple[float, float] = (0.0, 0.0),
        imperfections: Imperfections = NOMINAL,
    ) -> None:
        super().__init__()
        self.transfer = make_transfer(
            camera,
            scene,
            embedding,
            reach=reach,
            step=step,
            colour=colour,
            variables=variables,
            beams=beams,
            approximation=approximation,
            centre=centre,
            imperfections=imperfections,
            like=torch.empty(0, dtype=dtype),
        )
        """What computes, on this module's buffers."""
        self.reach = reach
        for name, table in self.transfer.arrays().items():
            self.register_buffer(name, table)

    @property
    def camera(self) -> Camera:
        """Camera of the transfer."""
        return self.transfer.camera

    @property
    def scene(self) -> Scene:
        """Scene before the camera."""
        return self.transfer.scene

    @property
    def embedding(self) -> Embedding:
        """Embedding of the camera."""
        return self.transfer.embedding

    @property
    def colour(self) -> bool:
        """True where the three channels are kept apart."""
        return self.transfer.colour

    @property
    def dtype(self) -> torch.dtype:
        """Type of every result."""
        dtype: torch.dtype = self.transfer.dtype
        return dtype

    def forward(self, weights: Tensor, region: Region | None = None) -> Tensor:
        """Return the transfer matrix of a mask, or of each of several; see :class:`Transfer`."""
        return self.transfer(weights, region)

    def embed(self, scenes: Tensor, weights: Tensor) -> Tensor:
        """Noiseless embeddings of scenes behind a mask; see :meth:`Transfer.embed`."""
        return self.transfer.embed(scenes, weights)

    def embed_by_factors(self, scenes: Tensor, weights: Tensor) -> Tensor:
        """Embed scenes without forming the matrix; see :meth:`Transfer.embed_by_factors`."""
        return self.transfer.embed_by_factors(scenes, weights)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        """Compute on what a type or device that is asked for makes of the buffers."""
        super()._apply(fn, recurse)  # type: ignore[no-untyped-call]
        self.transfer = Transfer.from_arrays(
            self.camera, self.scene, self.embedding, dict(self.named_buffers())
        )
        return self
