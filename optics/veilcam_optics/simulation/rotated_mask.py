"""The grid path for a mask that is shifted and turned by any angle."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import CHANNELS, Camera, Embedding, Scene
from veilcam_optics.camera.masks import check_weights
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.base import complex_type
from veilcam_optics.propagation.psf import PointSpread
from veilcam_optics.propagation.sampling import Grid, as_float, axis, covering_grid
from veilcam_optics.transfer.grid import GridLight

_SAMPLES_PER_CELL = 5


class RotatedMask:
    """A turned and shifted mask as amplitudes on a grid.

    Args:
        camera: panel and window.
        pitch: of the grid [m].
        rotation: from x towards y [rad].
        shift_y: [m].
        shift_x: [m].
        dtype: of the amplitudes.
    """

    def __init__(
        self,
        camera: Camera,
        pitch: float,
        *,
        rotation: float,
        shift_y: float,
        shift_x: float,
        dtype: torch.dtype,
    ) -> None:
        panel, (rows, columns) = camera.panel, camera.mask_shape
        height, width = rows * panel.pitch_y, columns * panel.pitch_x
        sine, cosine = math.sin(rotation), math.cos(rotation)
        self.grid = covering_grid(
            height * abs(cosine) + width * abs(sine) + 2 * abs(shift_y),
            height * abs(sine) + width * abs(cosine) + 2 * abs(shift_x),
            pitch,
        )
        cells = self.grid.rows * self.grid.columns
        y, x = (
            values - shift
            for values, shift in zip(
                (self.grid.y(), self.grid.x()), (shift_y, shift_x), strict=True
            )
        )
        inside = axis(_SAMPLES_PER_CELL, pitch / _SAMPLES_PER_CELL)
        found = []
        for dy in inside:
            for dx in inside:
                # Each sample is turned back to where the panel is straight.
                v = cosine * (y + dy)[:, None] - sine * (x + dx)
                u = sine * (y + dy)[:, None] + cosine * (x + dx)
                row, in_row = _aperture(v, rows, panel.pitch_y, panel.aperture_y)
                column, in_column = _aperture(u, columns, panel.pitch_x, panel.aperture_x)
                here = (in_row & in_column).flatten()
                cell = here.nonzero().flatten()
                found.append(cell * (rows * columns) + (row * columns + column).flatten()[cell])
        pairs, counts = torch.unique(torch.cat(found), return_counts=True)
        cell, aperture = pairs // (rows * columns), pairs % (rows * columns)
        shares = counts.double() / _SAMPLES_PER_CELL**2
        covered = torch.zeros(cells, dtype=torch.float64).index_add(0, cell, shares)
        # The root of the covered share, so that the power through a cell is exact.
        values = (shares / covered[cell].sqrt()).to(dtype)
        self._matrix = torch.sparse_coo_tensor(
            torch.stack([cell, aperture]), values, (cells, rows * columns), check_invariants=False
        ).coalesce()

    def __call__(self, weights: Tensor) -> Tensor:
        """Amplitudes on ``grid`` of ``weights``, the mask's; differentiable."""
        amplitudes: Tensor = self._matrix @ weights.reshape(-1, 1)
        return amplitudes.reshape(self.grid.shape)


class RotatedLight:
    """Light through a turned and shifted mask, from mask to embedding, on a grid."""

    def __init__(
        self,
        camera: Camera,
        scene: Scene,
        *,
        rotation: float,
        shift_y: float,
        shift_x: float,
        oversampling: float,
        dtype: torch.dtype,
    ) -> None:
        self.camera, self.dtype = camera, dtype
        self._light = GridLight(camera, scene, oversampling=oversampling, dtype=dtype)
        target: Grid = self._light.grid
        self._mask = RotatedMask(
            camera,
            as_float(target.pitch_y),
            rotation=rotation,
            shift_y=shift_y,
            shift_x=shift_x,
            dtype=dtype,
        )
        self._spreads = [
            PointSpread(
                self._mask.grid,
                target,
                wavelength=wavelength,
                distance=camera.distance,
                scene_distance=scene.distance,
                propagator=AngularSpectrum(padding="reach"),
                dtype=complex_type(dtype),
            )
            for wavelength in camera.wavelengths
        ]

    def psf(self, weights: Tensor) -> Tensor:
        """Point spread function of each channel, (3, rows, columns); differentiable."""
        check_weights(weights, self.camera)
        weights = weights.to(self.dtype)
        return torch.stack(
            [
                spread(self._mask(weights * self._passed(channel)))
                for channel, spread in enumerate(self._spreads)
            ]
        )

    def embed(self, scenes: Tensor, psf: Tensor, embedding: Embedding) -> Tensor:
        """Gray embeddings of gray scenes, (batch, rows, columns)."""
        return self._light.embed(scenes, psf, embedding)

    def embed_colour(self, scenes: Tensor, psf: Tensor, embedding: Embedding) -> Tensor:
        """Embeddings of gray scenes through each channel, (batch, 3, rows, columns)."""
        repeated = scenes[:, None].expand(-1, len(CHANNELS), -1, -1)
        return self._light.embed_colour(repeated, psf, embedding)

    def _passed(self, channel: int) -> Tensor:
        return torch.tensor(self.camera.row_amplitudes(channel), dtype=self.dtype)[:, None]


def _aperture(position: Tensor, count: int, pitch: float, width: float) -> tuple[Tensor, Tensor]:
    """Index of the nearest aperture, and whether the position lies inside it."""
    index = (position / pitch + (count - 1) / 2).round().clamp(0, count - 1)
    middle = (index - (count - 1) / 2) * pitch
    return index.long(), (position - middle).abs() <= width / 2
