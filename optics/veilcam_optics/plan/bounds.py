"""What physics says of errors without a look at any transfer: bounds and closed forms."""

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
from veilcam_optics.transfer.operator import Reach

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
    """
    camera = actual_camera(model)
    sensor, embedding = camera.sensor, model.embedding
    box = max(
        min(sensor.height / embedding.rows, sensor.width / embedding.columns),
        model.scene.pixel_at_sensor(camera),
    )
    return min(1.0, max(camera.wavelengths) * camera.distance / (aperture * box))


def large_angles(model: Model, interference: float) -> float:
    """Relative L2 of Fresnel's approximation on the axis.

    Light that goes off at an angle theta is fainter than Fresnel has it by 5/2 theta^2: the cosine
    counts twice in the field and once in the flux (Goodman, equation 3-41). Where pairs interfere
    the phase is left out that they do not share, of ``pi rho^4 / (4 lambda d^3)`` (section 4.2.2).

    Args:
        model: camera, scene and embedding.
        interference: relative L2 of what interferes.
    """
    camera = actual_camera(model)
    fourths = 0.0
    for sensor, mask, aperture in _sides(camera):
        seen, spread = (sensor + mask) / 2 / camera.distance, max(camera.wavelengths) / aperture
        # Of such points a fifth of the largest is the root mean square of what pairs do not share.
        fourths += min(0.4 * seen**4, spread**4)
    phase = math.pi / 4 * camera.distance / min(camera.wavelengths) * fourths
    fainter = 2.5 * _angles_squared(camera) + _near_scene(model)
    return min(1.0, math.hypot(fainter, min(1.0, phase) * interference / 2))


def slanted_flux(model: Model) -> float:
    """Relative L2 of what exact light on the axis leaves out, too, where it takes |field|^2.

    That is the cosine of the flux, 1/2 theta^2.
    """
    return min(1.0, _angles_squared(actual_camera(model)) / 2 + _near_scene(model))


def _angles_squared(camera: Camera) -> float:
    """Root mean square of theta^2 in the light that is seen, theta [rad] to the axis.

    Angles are those that mask and sensor span, or, if these are smaller, those to which an aperture
    spreads light: the tail of sinc^2, as far as the sensor sees.
    """
    total = 0.0
    for sensor, mask, aperture in _sides(camera):
        spread = max(camera.wavelengths) / aperture
        seen = (sensor + mask) / 2 / camera.distance
        # Of points spread evenly over two lengths, sqrt(<x^4>) is about 3/2 <x^2>.
        spanned = 1.5 * (sensor**2 + mask**2) / 12 / camera.distance**2
        # The integrals of (u^2 sinc^2 u)^2 up to ``seen`` over that of sinc^4.
        total += min(spanned, math.sqrt(9 / 8 / math.pi**4 * spread**3 * seen))
    return total


def _near_scene(model: Model) -> float:
    """Relative L2 of taking the light of a scene point for as bright on all of the mask.

    It comes at an angle of its own to every part, and is fainter there by 3/2 theta^2: the cube of
    the cosine, of twice the distance and of the slant.
    """
    masks = (mask for _, mask, _ in _sides(actual_camera(model)))
    return 1.5 * sum(1.5 * mask**2 / 12 for mask in masks) / model.scene.distance**2


def oblique_angles(model: Model) -> float:
    """Relative L2 of taking light that comes at an angle for light on the axis, but stretched.

    Of what leaves at phi + theta and at phi - theta, the one is fainter: by 5 tan(phi) theta of the
    mean. Pixels wider than the spread average that.
    """
    camera = actual_camera(model)
    sensor, embedding = camera.sensor, model.embedding
    image = model.scene.pixel_at_sensor(camera)
    tangents_squared = [
        (math.tan(model.conditions.off_axis or 0.0) * count / model.scene.rows) ** 2 / 3
        for count in model.scene.shape
    ]
    total = 0.0
    for (side, mask, aperture), squared, pixel in zip(
        _sides(camera),
        tangents_squared,
        (sensor.height / embedding.rows, sensor.width / embedding.columns),
        strict=True,
    ):
        spread = max(camera.wavelengths) / aperture
        seen = math.sqrt((side**2 + mask**2) / 12) / camera.distance
        # The root of <u^2> weighted with sinc^4 u is 0.28.
        angle = min(seen, 0.28 * spread)
        averaged = min(1.0, spread * camera.distance / max(pixel, image))
        total += squared * (5 * angle * averaged) ** 2
    return min(1.0, math.sqrt(total))


def _sides(camera: Camera) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Lengths of sensor, mask and aperture along y and x."""
    panel, window = camera.panel, camera.window
    return (
        (camera.sensor.height, window.rows * panel.pitch_y, panel.aperture_y),
        (camera.sensor.width, window.columns * panel.pitch_x, panel.aperture_x),
    )


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
        meeting = _meeting(camera)
        bounds *= torch.tensor([rows in meeting for rows in range(count)])
    return bounds


def _meeting(camera: Camera) -> set[int]:
    """How far apart rows are that pass light of one channel."""
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
    """Whether the fringes of the model's reach can be sampled."""
    return fringe_step(model, model.sampling.reach) > 1.01 * smallest_step(model)


def smallest_step(model: Model) -> float:
    """Below it the fields would take too much memory [m]."""
    rows, columns = model.camera.mask_shape
    nodes_y, nodes_x = nodes(model.with_sampling(step=1.0e-6))
    return 1.0e-6 * max(nodes_y * rows, nodes_x * columns) / _MOST_VALUES


def nearest_rows(camera: Camera) -> int:
    """Rows between the nearest two that interfere at all."""
    return min(_meeting(camera), default=1)
