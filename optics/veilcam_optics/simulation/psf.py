"""Point spread function of a mask, by the whole field.

Embedding pixels average fringes away that cells as small as a picture's do not, so that a plan's
reach, which is enough for its embedding, is not enough here.
"""

import math

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import CHANNELS, Camera
from veilcam_optics.camera.inputs import check_weights
from veilcam_optics.effects.composition import beams, shown
from veilcam_optics.effects.mask import actual_camera
from veilcam_optics.effects.model import Model
from veilcam_optics.errors import require, require_count
from veilcam_optics.propagation.base import complex_type
from veilcam_optics.propagation.sampling import axis
from veilcam_optics.transfer.factored import aperture_fields
from veilcam_optics.transfer.tables import Beam

_MOST_SAMPLES = 16
"""Of a cell along each axis: finer fringes are averaged over by chance."""


def psf(model: Model, weights: Tensor, rows: int) -> Tensor:
    """Irradiance of a scene point on the axis, as means over equal cells that cover the sensor.

    Equation (2) of docs/mathematics.md, squared: every pair of sub-pixels interferes.

    Args:
        model: model with the effects that count.
        weights: amplitude transmittances asked of the panel, ``camera.mask_shape``.
        rows: cells along the sensor's short side; those along the long one are about square.

    Returns:
        (3, rows, columns), relative to the irradiance at the mask; differentiable.

    Raises:
        OpticsError: the mask has another shape or holds NaN; no rows; a turned mask.
    """
    require_count("rows", rows)
    check_weights(weights, model.camera)
    turned = model.conditions.imperfections.rotation
    require(
        turned == 0,
        "imperfections.rotation",
        turned,
        "rad",
        "0: the field of a turned mask is no product of rows and columns",
    )
    amplitudes = shown(model, weights.to(model.sampling.dtype))
    channels = list(weights.new_zeros(len(CHANNELS)).unbind())
    for beam in beams(model):
        light = _irradiance(model, beam, amplitudes, rows)
        channels[beam.channel] = channels[beam.channel] + beam.share * light
    return torch.stack(channels)


def psf_shape(camera: Camera, rows: int) -> tuple[int, int]:
    """So many rows of cells over the whole sensor, and columns that make them about square."""
    return rows, max(1, round(rows * camera.sensor.width / camera.sensor.height))


def _irradiance(model: Model, beam: Beam, amplitudes: Tensor, rows: int) -> Tensor:
    """Means of one beam's irradiance over the cells, (rows, columns)."""
    camera, built = actual_camera(model), model.conditions.imperfections
    panel, sensor = camera.panel, camera.sensor
    fields, samples = [], []
    for count, length, centres, width, shift in zip(
        psf_shape(camera, rows),
        (sensor.height, sensor.width),
        (camera.row_centres, camera.column_centres),
        (panel.aperture_y, panel.aperture_x),
        (built.shift_y, built.shift_x),
        strict=True,
    ):
        fringe = float(beam.wavelength) * camera.distance / (centres[-1] - centres[0] + width)
        inside = min(_MOST_SAMPLES, math.ceil(2.5 * length / count / fringe))
        scene_distance = beam.scene_distance or model.scene.distance
        fields.append(
            aperture_fields(
                axis(count * inside, length / count / inside),
                torch.tensor(centres, dtype=torch.float64) + shift,
                width,
                wavelength=beam.wavelength,
                source_distance=scene_distance,
                distance=camera.distance,
            ).to(complex_type(amplitudes.dtype))
        )
        samples.append(inside)
    passed = torch.tensor(camera.row_amplitudes(beam.channel), dtype=amplitudes.dtype)
    mask = (passed[:, None] * amplitudes).to(fields[0].dtype)
    field = fields[0] @ mask @ fields[1].T
    light = field.real.square() + field.imag.square()
    cells = light.reshape(rows, samples[0], -1, samples[1])
    return cells.mean((1, 3))
