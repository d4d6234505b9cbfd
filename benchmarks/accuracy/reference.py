"""The converged float64 reference: the whole field, sampled finely, averaged over boxes.

``U = F w G^T``, equation (2) of docs/mathematics.md, with every interference term is sampled on
cells much finer than any fringe that survives the averaging; ``|U|^2`` is then integrated against
pixel boxes cell by cell (midpoint rule). Light from every scene point is as bright as light along
the axis. Nothing is shared with the transfer operator's kernels but the field of one aperture.
"""

import math
from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import CHANNELS, Camera, Embedding, Scene
from veilcam_optics.camera.inputs import check_weights
from veilcam_optics.errors import require_count, require_memory
from veilcam_optics.propagation.base import complex_type
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.transfer.binning import as_matrix, axis_boxes
from veilcam_optics.transfer.factored import aperture_fields
from veilcam_optics.transfer.grid import sample_pitch

_ROWS_AT_ONCE = 128


def reference_transfer(
    camera: Camera,
    scene: Scene,
    embedding: Embedding,
    weights: Tensor,
    *,
    oversampling: int = 32,
    colour: bool = False,
) -> Tensor:
    """Return the transfer matrix by brute force, the truth that faster ways are measured against.

    Args:
        camera: geometry, filters and wavelengths.
        scene: flat object.
        embedding: shape of the embedding.
        weights: amplitude transmittances, ``camera.mask_shape``.
        oversampling: cells per 8 sensor pixels (12.4 um) along each axis. The fringes of two
            sub-pixels ``Delta`` apart have the period ``lambda d2 / Delta``; a cell as long as that
            takes them for a constant. 32 keeps every fringe of the default window shorter-lived
            than that and agrees with twice as many to 3e-5, while 16 is still 1e-3 away.
        colour: True keeps the three channels apart, False sums them to a gray measurement.

    Returns:
        float64 (scene pixels, embedding pixels), or (3, scene pixels, embedding pixels) in colour.

    Raises:
        OpticsError: the mask has another shape or holds NaN, or ``oversampling`` is below 1.
    """
    check_weights(weights, camera)
    require_count("oversampling", oversampling)
    pitch = sample_pitch(camera, oversampling)
    height, width = camera.lit_sides(scene)
    shape = (math.ceil(height / pitch), math.ceil(width / pitch))
    offsets = max(scene.rows * embedding.rows, scene.columns * embedding.columns)
    require_memory(
        "oversampling",
        oversampling,
        "samples per 8 sensor pixels",
        float(max(shape)) * offsets,
        "fewer, a nearer sensor or a smaller scene",
    )
    row_boxes, column_boxes = axis_boxes(camera, scene, embedding, shape, pitch)
    outputs = [[channel] for channel in range(3)] if colour else [[0, 1, 2]]
    shares = (1.0, 1.0, 1.0) if colour else camera.sensor.channel_weights
    grid = Grid.square(*shape, pitch)
    transfers = []
    for channels in outputs:
        lines = torch.zeros(len(row_boxes), grid.columns, dtype=torch.float64)
        for rows, irradiance in _irradiance(
            camera, scene, weights, grid=grid, channels=channels, shares=shares
        ):
            boxes = row_boxes[:, rows]
            # A box is narrow: most do not reach these rows.
            reached = boxes.any(dim=1).nonzero().flatten()
            lines[reached] += boxes[reached] @ irradiance
        transfers.append(lines @ column_boxes.T)
    matrices = as_matrix(torch.stack(transfers), scene, embedding)
    return matrices if colour else matrices[0]


def reference_psf(
    camera: Camera, scene: Scene, weights: Tensor, grid: Grid, *, oversampling: int = 16
) -> Tensor:
    """Return the point spread function of an on-axis scene point, averaged over cells of ``grid``.

    Args:
        camera: geometry, filters and wavelengths.
        scene: gives the distance of the point.
        weights: amplitude transmittances, ``camera.mask_shape``.
        grid: the cells, centred on the axis.
        oversampling: samples per cell along each axis.

    Returns:
        float64 (3, grid.rows, grid.columns), relative to the irradiance at the mask.

    Raises:
        OpticsError: the mask has another shape or holds NaN, or ``oversampling`` is below 1.
    """
    check_weights(weights, camera)
    require_count("oversampling", oversampling)
    rows, columns = grid.shape
    fine = Grid(
        rows * oversampling,
        columns * oversampling,
        float(grid.pitch_y) / oversampling,
        float(grid.pitch_x) / oversampling,
    )
    psf = torch.zeros(len(CHANNELS), rows, columns, dtype=torch.float64)
    for channel in range(len(CHANNELS)):
        lines = [
            irradiance.reshape(-1, columns, oversampling).mean(2)
            for _, irradiance in _irradiance(
                camera, scene, weights, grid=fine, channels=[channel], shares=(1.0,) * 3
            )
        ]
        psf[channel] = torch.cat(lines).reshape(rows, oversampling, columns).mean(1)
    return psf


def sampled_psf(
    camera: Camera, scene: Scene, grid: Grid, dtype: torch.dtype
) -> Callable[[Tensor], Tensor]:
    """Point spread function of an on-axis scene point at a grid's points, made for many masks.

    Args:
        camera: geometry, filters and wavelengths.
        scene: gives the distance of the point.
        grid: places of the irradiance.
        dtype: torch.float32 or torch.float64.

    Returns:
        From weights (``camera.mask_shape``) to the irradiance (3, rows, columns), relative to that
        at the mask.
    """
    field_type = complex_type(dtype)
    fields = []
    for channel in range(len(CHANNELS)):
        open_rows, amplitudes, along_y, along_x = _fields(camera, scene, grid, channel)
        along_y = (along_y * amplitudes).to(field_type)
        fields.append((open_rows, along_y, along_x.to(field_type).T))

    def psf(weights: Tensor) -> Tensor:
        channels = []
        for open_rows, along_y, along_x in fields:
            field = along_y @ (weights[open_rows].to(field_type) @ along_x)
            channels.append(field.real.square() + field.imag.square())
        return torch.stack(channels)

    return psf


def _fields(
    camera: Camera, scene: Scene, grid: Grid, channel: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Rows that pass a channel, their amplitudes, and F and G of these rows and all columns."""
    amplitudes = torch.tensor(camera.row_amplitudes(channel), dtype=torch.float64)
    open_rows = amplitudes.nonzero().flatten()
    field_y, field_x = (
        aperture_fields(
            nodes,
            torch.tensor(centres, dtype=torch.float64),
            width,
            wavelength=camera.wavelengths[channel],
            source_distance=scene.distance,
            distance=camera.distance,
        )
        for nodes, centres, width in (
            (grid.y(), camera.row_centres, camera.panel.aperture_y),
            (grid.x(), camera.column_centres, camera.panel.aperture_x),
        )
    )
    return open_rows, amplitudes[open_rows], field_y[:, open_rows], field_x


def _irradiance(
    camera: Camera,
    scene: Scene,
    weights: Tensor,
    *,
    grid: Grid,
    channels: list[int],
    shares: tuple[float, ...],
) -> Iterator[tuple[slice, Tensor]]:
    """Yield |U|^2 of some rows of the grid at a time, summed over channels with their shares."""
    spreads = []
    for channel in channels:
        open_rows, amplitudes, rows_field, field_x = _fields(camera, scene, grid, channel)
        scale = amplitudes[:, None] * math.sqrt(shares[channel])
        passed = scale * weights.detach().double()[open_rows]
        spread = passed.to(field_x.dtype) @ field_x.T
        # Real products of (re, im) run three times faster than one complex product.
        left_re = torch.cat([rows_field.real, -rows_field.imag], dim=1)
        left_im = torch.cat([rows_field.imag, rows_field.real], dim=1)
        spreads.append((left_re, left_im, torch.cat([spread.real, spread.imag])))
    for start in range(0, grid.rows, _ROWS_AT_ONCE):
        rows = slice(start, min(start + _ROWS_AT_ONCE, grid.rows))
        total = torch.zeros(rows.stop - start, grid.columns, dtype=torch.float64)
        for left_re, left_im, spread in spreads:
            for left in (left_re, left_im):
                part = left[rows] @ spread
                total.addcmul_(part, part)
        yield rows, total
