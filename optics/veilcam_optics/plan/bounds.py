"""Bounds of errors and closed forms, without a look at any transfer."""

import math

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import CHANNELS, Camera
from veilcam_optics.effects.composition import beams
from veilcam_optics.effects.mask import actual_camera
from veilcam_optics.effects.model import Model
from veilcam_optics.plan.boxes import box_cells
from veilcam_optics.plan.cost import nodes
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.transfer.grid import cells_in_aperture, sample_pitch
from veilcam_optics.transfer.tables import Reach

_MAX_VALUES = 400_000
"""Field values in the boxes of one axis: some 30 ms. Pairs that need more are bounded alone."""

_MOST_VALUES = 1_200_000
"""Field values of a whole axis: more are too many for an operator to be made quickly."""

_GRID_ERROR, _GRID_ORDER, _GRID_SPREAD = 0.105, 0.7, 5.5
"""The grid's error is about 0.105 / (samples across an aperture)^0.7: cells cut apertures.

Light that they misplace stays in its pixel where pixels are wide; else it is wrong by 5.5 times
as much as diffraction spreads it, in pixels. Measured for apertures of 6 to 60 um, 0.2 to 4 mm
before the sensor, 2 to 40 samples across: within a factor of 2, but for less error at 2 to 4.
"""


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
    box = max(
        min(sensor.height / embedding.rows, sensor.width / embedding.columns),
        model.scene.pixel_at_sensor(camera),
    )
    wavelength, distance = max(camera.wavelengths), camera.distance
    lost = 2 * wavelength / (math.pi**2 * aperture) * math.atan(box / distance)
    return min(1.0, math.hypot(wavelength * distance / (aperture * box), lost))


def near_scene(model: Model) -> float:
    """Relative L2 of taking the light of a scene point for as bright on all of the mask.

    It comes at an angle of its own to every part, and is fainter there by 3/2 theta^2: the cube of
    the cosine, of twice the distance and of the slant.
    """
    camera = actual_camera(model)
    panel, window = camera.panel, camera.window
    # Of points spread evenly over a length, sqrt(<x^4>) is about 3/2 <x^2>.
    sides = (window.rows * panel.pitch_y) ** 2 + (window.columns * panel.pitch_x) ** 2
    return 1.5 * 1.5 * sides / 12 / model.scene.distance**2


def grid_error(model: Model, oversampling: float) -> float:
    """Relative L2 of the grid path in axial light; 1 where it cannot work."""
    camera, scene = actual_camera(model), model.scene
    sensor, panel = camera.sensor, camera.panel
    cell = sample_pitch(camera, oversampling)
    image = scene.pixel_at_sensor(camera)
    height, width = camera.lit_sides(scene)
    mask = Grid.square(
        math.ceil(camera.window.rows * panel.pitch_y / cell),
        math.ceil(camera.window.columns * panel.pitch_x / cell),
        cell,
    )
    target = Grid.square(math.ceil(height / cell), math.ceil(width / cell), cell)
    propagator = AngularSpectrum(padding="reach")
    if not all(
        propagator.supports(mask, target, camera.distance, wavelength)
        for wavelength in camera.wavelengths
    ):
        return 1.0
    embedding = model.embedding
    pixel = min(sensor.height / embedding.rows, sensor.width / embedding.columns)
    error = _GRID_ERROR / cells_in_aperture(camera, oversampling) ** _GRID_ORDER
    aperture = min(panel.aperture_y, panel.aperture_x)
    spread = max(camera.wavelengths) * camera.distance / aperture
    # Errors of cells average out over larger pixels, not over smaller ones.
    widest = max(1.0, 2 * cell / (pixel + image), _GRID_SPREAD * spread / (pixel + image))
    return float(min(1.0, error * widest))


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
    pixel = (sensor.height / embedding.rows, sensor.width / embedding.columns)[axis]
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
        lit = torch.tensor(camera.row_amplitudes(channel)).nonzero().flatten()
        found.update((lit[:, None] - lit).flatten().tolist())
    return {rows for rows in found if rows > 0}


def affordable_reach(model: Model, axis: int, offsets: int) -> int:
    """Largest reach whose fringes are resolved in boxes with few enough field values."""
    camera = actual_camera(model)
    panel, sensor, embedding = camera.panel, camera.sensor, model.embedding
    count = camera.mask_shape[axis]
    pitch, width = ((panel.pitch_y, panel.aperture_y), (panel.pitch_x, panel.aperture_x))[axis]
    pixel = (sensor.height / embedding.rows, sensor.width / embedding.columns)[axis]
    side = pixel + model.scene.pixel_at_sensor(camera)
    shortest = float(min(beam.wavelength for beam in beams(model)))
    reach = 0
    while reach + 1 < count:
        cells = box_cells(side, shortest, camera.distance, width + (reach + 1) * pitch)
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
    pixel = min(sensor.height / embedding.rows, sensor.width / embedding.columns)
    image = model.scene.pixel_at_sensor(camera)
    wanted = min(float(shortest) / apart / 2.2, (pixel + image) / 8)
    return max(wanted, smallest_step(model))


def resolved(model: Model) -> bool:
    """Return whether the fringes of the model's reach can be sampled."""
    return fringe_step(model, model.sampling.reach) > 1.01 * smallest_step(model)


def smallest_step(model: Model) -> float:
    """Below it the fields would take too much memory [m]."""
    rows, columns = model.camera.mask_shape
    nodes_y, nodes_x = nodes(model.with_sampling(step=1.0e-6))
    return 1.0e-6 * max(nodes_y * rows, nodes_x * columns) / _MOST_VALUES


def nearest_rows(camera: Camera) -> int:
    """Rows between the nearest two that interfere at all."""
    return min(meeting_rows(camera), default=1)
