"""Ways from a mask to its point spread function, prepared on one grid."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import CHANNELS, Camera, Scene
from veilcam_optics.camera.masks import random_mask
from veilcam_optics.propagation import GeometricShadow, Propagator
from veilcam_optics.propagation.base import complex_type
from veilcam_optics.propagation.psf import AT_INFINITY, PointSpread
from veilcam_optics.propagation.sampling import Grid, coverage, covering_grid
from veilcam_optics.transfer.factored import aperture_fields

PRECISIONS = {"float32": torch.float32, "float64": torch.float64}

Psf = Callable[[Tensor], Tensor]
"""From weights to the irradiance (3, rows, columns)."""


def example_mask(camera: Camera) -> Tensor:
    """The mask that the jobs use: uniform random, float64, always the same."""
    return random_mask(camera, torch.Generator().manual_seed(2022)).double()


def factored_psf(camera: Camera, scene: Scene, grid: Grid, dtype: torch.dtype) -> Psf:
    """The factored field ``|F w G^T|^2`` at the grid's points.

    Args:
        camera: geometry, filters and wavelengths.
        scene: gives the distance of the on-axis point.
        grid: where the irradiance is wanted.
        dtype: torch.float32 or torch.float64.
    """
    field_type = complex_type(dtype)
    fields = []
    for channel, wavelength in enumerate(camera.wavelengths):
        amplitudes = torch.tensor(camera.row_amplitudes(channel), dtype=torch.float64)
        open_rows = amplitudes.nonzero().flatten()
        along_y, along_x = (
            aperture_fields(
                nodes,
                torch.tensor(centres, dtype=torch.float64),
                width,
                wavelength=wavelength,
                source_distance=scene.distance,
                distance=camera.distance,
            )
            for nodes, centres, width in (
                (grid.y(), camera.row_centres, camera.panel.aperture_y),
                (grid.x(), camera.column_centres, camera.panel.aperture_x),
            )
        )
        along_y = (along_y * amplitudes)[:, open_rows]
        fields.append((open_rows, along_y.to(field_type), along_x.to(field_type).T))

    def psf(weights: Tensor) -> Tensor:
        channels = []
        for open_rows, along_y, along_x in fields:
            field = along_y @ (weights[open_rows].to(field_type) @ along_x)
            channels.append(field.real.square() + field.imag.square())
        return torch.stack(channels)

    return psf


def mask_grid(camera: Camera, pitch: float) -> Grid:
    """The smallest grid of cells of side ``pitch`` [m] that holds the mask."""
    window, panel = camera.window, camera.panel
    return covering_grid(
        (window.rows - 1) * panel.pitch_y + panel.aperture_y,
        (window.columns - 1) * panel.pitch_x + panel.aperture_x,
        pitch,
    )


def sampled_masks(
    camera: Camera, grid: Grid, dtype: torch.dtype
) -> Callable[[Tensor], list[Tensor]]:
    """From weights to the transmittance that each channel sees on a grid, dead space included.

    A cell covered in part gets the amplitude that lets the right power through.
    """

    def amplitudes(centres: tuple[float, ...], width: float, cells: int, pitch: float) -> Tensor:
        middle = torch.tensor(centres, dtype=torch.float64)
        shares = coverage(middle - width / 2, middle + width / 2, cells, pitch)
        return (shares / shares.sum(0).clamp(min=1e-12).sqrt()).to(dtype)

    panel = camera.panel
    rows = amplitudes(camera.row_centres, panel.aperture_y, grid.rows, float(grid.pitch_y))
    columns = amplitudes(camera.column_centres, panel.aperture_x, grid.columns, float(grid.pitch_x))
    filters = [
        torch.tensor(camera.row_amplitudes(channel), dtype=dtype)[:, None]
        for channel in range(len(CHANNELS))
    ]
    return lambda weights: [rows.T @ (weights * passed) @ columns for passed in filters]


def grid_psf(
    camera: Camera, scene: Scene, grid: Grid, propagator: Propagator, dtype: torch.dtype
) -> Psf:
    """A mask sampled on a grid of the same pitch, carried to the sensor by any propagator.

    Args:
        camera: geometry, filters and wavelengths.
        scene: gives the distance of the on-axis point.
        grid: where the irradiance is wanted, in square cells.
        propagator: the method.
        dtype: torch.float32 or torch.float64.
    """
    source = mask_grid(camera, float(grid.pitch_y))
    masks = sampled_masks(camera, source, dtype)
    # A shadow takes the mask alone: it knows where the light comes from.
    lit_by_itself = isinstance(propagator, GeometricShadow)
    spreads = [
        PointSpread(
            source,
            grid,
            wavelength=wavelength,
            distance=camera.distance,
            scene_distance=AT_INFINITY if lit_by_itself else scene.distance,
            propagator=propagator,
            dtype=complex_type(dtype),
        )
        for wavelength in camera.wavelengths
    ]

    def psf(weights: Tensor) -> Tensor:
        pairs = zip(spreads, masks(weights), strict=True)
        return torch.stack([spread(mask) for spread, mask in pairs])

    return psf
