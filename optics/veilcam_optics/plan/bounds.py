"""Bounds of errors and closed forms, without a look at any transfer."""

import math

import numpy as np
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import CHANNELS, Camera
from veilcam_optics.effects.composition import beams
from veilcam_optics.effects.mask import actual_camera
from veilcam_optics.effects.model import Model
from veilcam_optics.effects.sensor import mean_shares
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan.cost import meetings, nodes
from veilcam_optics.transfer.entries import node_count
from veilcam_optics.transfer.tables import Reach

_MAX_VALUES = 250_000
"""Field values in the boxes of one axis: some 20 ms. Pairs that need more are bounded alone."""

_OFFSETS, _LINES = 6, 64
"""Offsets, and lines of the mask, in whose boxes one aperture's fringes are resolved at least."""

_MOST_VALUES = 1_200_000
"""Field values of a whole axis: more are too many for an operator to be made quickly."""

_NODES_IN_FRINGE, _NODES_IN_BOX = 6, 8
"""Nodes of an operator in the finest fringe, and in a box: see :data:`QUADRATURE`."""

QUADRATURE = 3e-5
"""Relative L2 of the integration: 1e-7 where few pairs interfere, 5e-5 where all do; measured."""


def check_lit(model: Model) -> None:
    """Raise :class:`OpticsError` if no light that the sensor counts passes the panel."""
    camera, built = model.camera, model.conditions.imperfections
    rows, columns = camera.mask_shape
    obey = np.ones(rows)
    obey[list(built.dead_rows)] = built.dead_transmittance
    if len(set(built.dead_columns)) == columns:
        obey[:] = built.dead_transmittance
    if not any(
        share and (np.array(camera.row_amplitudes(channel)) * obey).any()
        for channel, share in enumerate(mean_shares(model))
    ):
        raise OpticsError(
            "camera sees no light: use a panel with a row that obeys, and whose filter passes a "
            "colour that the sensor counts"
        )


def shadow_error(model: Model, aperture: float) -> float:
    """Relative L2 of geometric shadows where diffraction is too fine to be sampled.

    An edge blurs over ``sqrt(lambda d)``: that share of an aperture's light moves, and the pixels
    average it away in the same proportion. Measured within a factor of 2 from 20 um to 1 mm.

    And an aperture passes less than what falls on it. Of the light that its two edges spread,
    ``lambda / (pi^2 a t^2)`` at the tangent t, exact waves bring ``1 / (1 + t^2)``. So on a pixel
    that holds all of it, ``lambda / (pi^2 a) atan(t)`` is missing along each axis.
    """
    camera = actual_camera(model)
    sensor, embedding = camera.sensor, model.embedding
    box = max(min(embedding.box(sensor)), model.scene.pixel_at_sensor(camera))
    wavelength, distance = max(camera.wavelengths), camera.distance
    lost = 2 * wavelength / (math.pi**2 * aperture) * math.atan(box / distance)
    return min(1.0, math.hypot(wavelength * distance / (aperture * box), lost))


def far_pairs(model: Model, axis: int) -> Tensor:
    """Bounds of what all pairs 0, 1, 2, ... sub-pixels apart add, relative to the irradiance.

    Two apertures' product has no spatial frequencies but those of the distances between their
    points, over ``lambda d``: behind the common quadratic phase, a Fresnel field is the Fourier
    transform of what is in the aperture. So, by Parseval's theorem, a box passes at most the
    largest of its own transform over that band, ``sinc(f pixel) sinc(f image)``; and one field in
    the shadow of the other aperture is at most ``sqrt(lambda d) / pi`` over the gap between them,
    the tail of Fresnel's integrals behind an edge.
    """
    camera = actual_camera(model)
    panel, sensor, embedding = camera.panel, camera.sensor, model.embedding
    count = camera.mask_shape[axis]
    pitch, width = ((panel.pitch_y, panel.aperture_y), (panel.pitch_x, panel.aperture_x))[axis]
    pixel = embedding.box(sensor)[axis]
    if not model.sampling.binning:
        pixel = 0.0
    image = model.scene.pixel_at_sensor(camera)
    spread = max(float(beam.wavelength) for beam in beams(model)) * camera.distance
    gap = (torch.arange(count, dtype=torch.float64) * pitch - width).clamp_min(0)
    passed = torch.ones(count, dtype=torch.float64)
    for side in (pixel, image):
        passed *= (1 / (math.pi * side * gap / spread)).clamp_max(1)
    shaded = (math.sqrt(2 * spread) / math.pi / gap).clamp_max(1)
    bounds = 2 * passed * shaded
    if axis == 0:
        meeting = meeting_rows(camera)
        bounds *= torch.tensor([rows in meeting for rows in range(count)])
    return bounds


def meeting_rows(camera: Camera) -> set[int]:
    """Return the distances, in rows, of two rows that pass light of one channel."""
    found: set[int] = set()
    for channel in range(len(CHANNELS)):
        found.update(rows for rows, pairs in enumerate(meetings(camera, channel)) if pairs)
    return found - {0}


def affordable_reach(model: Model, axis: int, offsets: int) -> int:
    """Largest reach whose fringes are resolved in boxes with few enough field values."""
    camera = actual_camera(model)
    panel, sensor, embedding = camera.panel, camera.sensor, model.embedding
    count = camera.mask_shape[axis]
    pitch, width = ((panel.pitch_y, panel.aperture_y), (panel.pitch_x, panel.aperture_x))[axis]
    pixel = embedding.box(sensor)[axis]
    side = pixel + model.scene.pixel_at_sensor(camera)
    shortest = float(min(beam.wavelength for beam in beams(model)))
    reach = 0
    while reach + 1 < count:
        cells = node_count(side, shortest * camera.distance / (width + (reach + 1) * pitch))
        if cells * offsets * count > _MAX_VALUES:
            break
        reach += 1
    return reach


def fringe_step(model: Model, reach: Reach) -> float:
    """Step that resolves the fringes of two sub-pixels as far apart as ``reach`` [m].

    The fringes of two points ``Delta`` apart have the period ``lambda d / Delta``; the aperture's
    own width adds to it. A pixel needs several nodes, too.
    """
    camera = actual_camera(model)
    panel, sensor, embedding = camera.panel, camera.sensor, model.embedding
    shortest = min(beam.wavelength for beam in beams(model)) * camera.distance
    apart = max(
        panel.aperture_y + min(reach.rows, camera.window.rows - 1) * panel.pitch_y,
        panel.aperture_x + min(reach.columns, camera.window.columns - 1) * panel.pitch_x,
    )
    pixel = min(embedding.box(sensor))
    image = model.scene.pixel_at_sensor(camera)
    wanted = min(float(shortest) / apart / _NODES_IN_FRINGE, (pixel + image) / _NODES_IN_BOX)
    return max(wanted, smallest_step(model))


def resolved(model: Model) -> bool:
    """Return whether the fringes of the model's reach can be sampled."""
    camera = actual_camera(model)
    shortest = float(min(beam.wavelength for beam in beams(model))) * camera.distance
    height, width = model.embedding.box(camera.sensor)
    for side, aperture, count in (
        (height, camera.panel.aperture_y, camera.window.rows),
        (width, camera.panel.aperture_x, 1),
    ):
        nodes_in_box = node_count(side + model.scene.pixel_at_sensor(camera), shortest / aperture)
        if nodes_in_box * min(count, _LINES) * _OFFSETS > _MAX_VALUES:
            return False
    return fringe_step(model, model.sampling.reach) > 1.01 * smallest_step(model)


def smallest_step(model: Model) -> float:
    """Below it the fields would take too much memory [m]."""
    rows, columns = model.camera.mask_shape
    nodes_y, nodes_x = nodes(model.with_sampling(step=1.0e-6))
    return 1.0e-6 * max(nodes_y * rows, nodes_x * columns) / _MOST_VALUES


def nearest_rows(camera: Camera) -> int:
    """Rows between the nearest two that interfere at all."""
    return min(meeting_rows(camera), default=1)
