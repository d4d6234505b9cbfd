"""Scenes that are not flat: a few layers, each with its own PSF and its own magnification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.errors import OpticsError, invalid, require_positive
from veilcam_optics.transfer.grid import GridLight


def scene_at(scene: Scene, distance: float) -> Scene:
    """Return the same field of view at another ``distance`` [m]: height in proportion."""
    require_positive("distance", distance, "m")
    return replace(scene, distance=distance, height=scene.height * distance / scene.distance)


def split_depth(pictures: Tensor, depth: Tensor, distances: Sequence[float]) -> Tensor:
    """Share every pixel out between the two layers nearest to its depth.

    Shares are linear in 1 / distance, as the wavefront's curvature is; what lies outside the layers
    goes to the nearest one. The layers sum to the picture.

    Args:
        pictures: Shape (..., rows, columns).
        depth: Distance of every pixel [m], shape (rows, columns) or that of ``pictures``.
        distances: Of the layers [m], increasing.

    Returns:
        Shape (..., layers, rows, columns).

    Raises:
        OpticsError: If the distances do not increase or a depth is not positive.
    """
    _check_distances(distances)
    if not bool((depth > 0).all()):
        raise OpticsError("depth holds values that are not > 0 m: use distances from the mask")
    curvature = [1 / distance for distance in distances]
    here = depth.double().reciprocal().clamp(curvature[-1], curvature[0])
    shares = []
    for layer, middle in enumerate(curvature):
        share = torch.ones_like(here)
        if layer > 0:
            share = torch.minimum(share, 1 - (here - middle) / (curvature[layer - 1] - middle))
        if layer < len(curvature) - 1:
            share = torch.minimum(share, 1 - (middle - here) / (middle - curvature[layer + 1]))
        shares.append(share.clamp(min=0))
    return pictures[..., None, :, :] * torch.stack(shares, dim=-3).to(pictures.dtype)


class LayeredLight:
    """Light from several depths; no layer hides another."""

    def __init__(
        self,
        camera: Camera,
        scene: Scene,
        distances: Sequence[float],
        oversampling: float = 2,
        dtype: torch.dtype = torch.float64,
    ) -> None:
        """Prepare one :class:`GridLight` per layer.

        Args:
            camera: Panel, window, sensor and their distance.
            scene: Field of view and shape of pictures; its own distance only scales its height.
            distances: Of the layers [m], increasing.
            oversampling: As of :class:`GridLight`.
            dtype: As of :class:`GridLight`.

        Raises:
            OpticsError: If the distances do not increase.
        """
        _check_distances(distances)
        self.lights = tuple(
            GridLight(camera, scene_at(scene, distance), oversampling, dtype)
            for distance in distances
        )

    def psf(self, weights: Tensor) -> tuple[Tensor, ...]:
        """Return the PSF of every layer, each as :meth:`GridLight.psf` gives it."""
        return tuple(light.psf(weights) for light in self.lights)

    def embed(self, layers: Tensor, psfs: Sequence[Tensor], embedding: Embedding) -> Tensor:
        """Return the gray embeddings (..., rows, columns) of layers (..., layers, rows, columns).

        Raises:
            OpticsError: If there are not as many layers as distances.
        """
        if layers.shape[-3] != len(self.lights) or len(psfs) != len(self.lights):
            shown = f"{layers.shape[-3]} layers and {len(psfs)} PSFs"
            raise invalid("layers", shown, "", f"{len(self.lights)} of both")
        parts = [
            light.embed(layers[..., number, :, :], psf, embedding)
            for number, (light, psf) in enumerate(zip(self.lights, psfs, strict=True))
        ]
        return torch.stack(parts).sum(0)


def _check_distances(distances: Sequence[float]) -> None:
    if not distances:
        raise invalid("distances", "nothing", "", "at least one distance")
    for distance in distances:
        require_positive("distances", distance, "m")
    if any(a >= b for a, b in pairwise(distances)):
        raise invalid("distances", tuple(distances), "m", "increasing distances")
