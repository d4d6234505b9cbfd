"""Masks of any layout, printed or of phase, and the transfer of a camera that has one.

A panel's mask is a grid of rectangles, so that its field is a product of rows and columns. Nothing
is known of these, but what they do to the wave cell by cell: their field is propagated on a grid.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import CHANNELS, LENGTHS, Camera, Embedding, Scene
from veilcam_optics.errors import (
    OpticsError,
    require,
    require_memory,
    require_within,
)
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.psf import PointSpread
from veilcam_optics.propagation.sampling import Grid, covering_grid
from veilcam_optics.transfer.reference import TransferBinning

_MARGIN = 16
"""Cells around a mask: of what a cell's edges ring, 1e-3 is farther away."""

_COPIES = 4
"""Of the padded grid, while it is propagated."""

_ROUNDING = 1e-5
"""What a cell may pass more than all light by, in float32."""


@dataclass(frozen=True, eq=False)
class FreeFormMask:
    """What every cell of a mask lets through.

    Attributes:
        transmittance: amplitudes, real or complex and none beyond 1: (rows, columns), centred on
            the axis, or (3, rows, columns) for R, G and B, whose phases differ behind a relief
            (:func:`veilcam_optics.apertures.phase_plate`). Beyond its cells a mask is dark.
        pitch: side of a cell [m].
    """

    transmittance: Tensor
    pitch: float

    def __post_init__(self) -> None:
        shape, values = tuple(self.transmittance.shape), self.transmittance.detach()
        fits = 0 not in shape and (len(shape) == 2 or (len(shape) == 3 and shape[0] == 3))
        require(fits, "transmittance.shape", shape, "", "(rows, columns) or (3, rows, columns)")
        numbers = values.is_floating_point() or values.is_complex()
        require(numbers, "transmittance.dtype", values.dtype, "", "real or complex numbers")
        require_within("pitch", self.pitch, "m", *LENGTHS)
        if not bool(torch.isfinite(values).all()):
            raise OpticsError("transmittance holds NaN or infinity: use finite amplitudes")
        least = 0.0 if values.is_complex() else float(values.min())
        within = least >= -_ROUNDING and float(values.abs().max()) <= 1 + _ROUNDING
        if not within:  # the message holds no value: a mask is a secret
            raise OpticsError(
                "transmittance holds values outside its range: use amplitudes from 0 to 1, or "
                "complex ones of that size"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Cells (rows, columns)."""
        rows, columns = self.transmittance.shape[-2:]
        return rows, columns

    @property
    def sides(self) -> tuple[float, float]:
        """Height and width [m]."""
        rows, columns = self.shape
        return rows * self.pitch, columns * self.pitch


def free_form_transfer(
    camera: Camera, scene: Scene, embedding: Embedding, mask: FreeFormMask
) -> Tensor:
    """The transfer matrix of a camera whose panel's place a mask of any layout takes.

    Cells are cut until a grid of them holds every wave that goes straight from the mask to the
    sensor or to a scene pixel's image around it; no plan is needed, and none is made. The field of
    a scene point on the axis is propagated by its angular spectrum, in which no angle is small, and
    its irradiance is moved over the scene: that a point off the axis has another one is left out.

    Args:
        camera: sensor, distance and wavelengths; neither panel nor window is looked at.
        scene: flat object.
        embedding: shape of the embedding.
        mask: in the panel's place.

    Returns:
        float64 (scene pixels, embedding pixels), relative to an all-white scene without a mask;
        differentiable in the mask.

    Raises:
        OpticsError: the grid does not fit in memory.
    """
    parts = _parts(camera, scene, mask)
    pitch = mask.pitch / parts
    cells = covering_grid(*camera.lit_sides(scene), pitch)
    rows, columns = (count * parts + 2 * _MARGIN for count in mask.shape)
    numbers = _COPIES * float(cells.rows + rows) * (cells.columns + columns)
    require_memory(
        "mask.sides", mask.sides, "m", numbers, "a smaller mask or sensor, or a larger distance"
    )
    values = _of_whole_cells(mask.transmittance, parts).expand(len(CHANNELS), rows, columns)
    light = torch.zeros(cells.shape, dtype=torch.float64)
    for share, wavelength, passed in zip(
        camera.sensor.channel_weights, camera.wavelengths, values, strict=True
    ):
        if share:
            spread = PointSpread(
                Grid.square(rows, columns, pitch),
                cells,
                wavelength=wavelength,
                distance=camera.distance,
                scene_distance=scene.distance,
                propagator=AngularSpectrum(),
            )
            light = light + share * spread(passed)
    binning = TransferBinning(camera, scene, embedding, shape=cells.shape, pitch=pitch)
    return binning(light)


def _parts(camera: Camera, scene: Scene, mask: FreeFormMask) -> int:
    """How many parts a cell's side is cut into: a grid holds sines up to ``lambda / (2 pitch)``."""
    sine = 0.0
    for side, lit in zip(mask.sides, camera.lit_sides(scene), strict=True):
        across = (side + lit) / 2
        steepest = across / math.hypot(across, camera.distance) + side / 2 / scene.distance
        sine = max(sine, min(1.0, steepest))
    return max(1, math.ceil(2 * mask.pitch * sine / min(camera.wavelengths)))


def _of_whole_cells(transmittance: Tensor, parts: int) -> Tensor:
    """Samples, so many to a cell, that stand for what is even within a cell; with a margin.

    Samples alone stand for points: their spectrum is that of the cells over ``sinc(f pitch)``.
    """
    cut = transmittance.repeat_interleave(parts, -2).repeat_interleave(parts, -1)
    values = torch.nn.functional.pad(cut.to(torch.complex128), (_MARGIN,) * 4)
    y, x = (
        torch.sinc(torch.fft.fftfreq(count, dtype=torch.float64)) for count in values.shape[-2:]
    )
    even: Tensor = torch.fft.ifft2(torch.fft.fft2(values) * y[:, None] * x)
    return even
