"""Errors at the embedding: of every effect if it were ignored, and of every sampling."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.effects.composition import beams, collected
from veilcam_optics.effects.light import OffAxis, stretch, tangents, zones
from veilcam_optics.effects.mask import DeadLines, actual_camera
from veilcam_optics.effects.model import Model
from veilcam_optics.plan.cost import nodes
from veilcam_optics.plan.probe import MAX_VALUES, Probe, relative
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.transfer.grid import cells_in_aperture, sample_pitch
from veilcam_optics.transfer.operator import Reach

_FINEST = {"wavelengths": 7, "layers": 9}
ROUNDING = {torch.float32: 5e-7, torch.float64: 0.0}
"""Relative L2 of a transfer matrix's number format, measured: kernels are cast from float64."""

_LEAST_TOLERANCE = 1e-5
"""Below it nothing is sampled any finer: no plan will get there."""

_MOST_SHELLS = 100
"""Farther reaches are not looked at: they would take longer to plan than to do without."""

_GRID_ERROR, _GRID_ORDER, _GRID_SPREAD = 0.105, 0.7, 5.5
"""The grid's error is about 0.105 / (samples across an aperture)^0.7: cells cut apertures.

Light that they misplace stays in its pixel where pixels are wide; else it is wrong by 5.5 times
as much as diffraction spreads it, in pixels. Measured for apertures of 6 to 60 um, 0.2 to 4 mm
before the sensor, 2 to 40 samples across: within a factor of 2, but for less error at 2 to 4.
"""


@dataclass(frozen=True, slots=True)
class Interferences:
    """Errors of every reach, for one choice of filters.

    Attributes:
        errors: (rows apart + 1, columns apart + 1), relative L2 of counting no farther.
        total: the transfer with all of them.
        model: the one it belongs to.
    """

    errors: Tensor
    total: Tensor
    model: Model


class ErrorModel:
    """Compares models with the one that has everything; see :class:`~...effects.Comparison`.

    Args:
        model: with every effect on.
        tolerance: errors far below it need not be known.
    """

    def __init__(self, model: Model, tolerance: float) -> None:
        self.tolerance = tolerance
        self._small = max(tolerance, _LEAST_TOLERANCE) / 10
        self._probe = Probe(model)
        panel = model.camera.panel
        self._shadow_error = shadow_error(model, min(panel.aperture_y, panel.aperture_x))
        # Very near the sensor fringes are too fine to be sampled, and too fine to matter.
        self.resolved = 3 * self._shadow_error > tolerance and _resolved(
            model.with_sampling(reach=Reach(0, 0))
        )
        """Whether fringes are sampled; else shadows are all that is known."""
        if not self.resolved:
            model = replace(model, sampling=replace(model.sampling, diffraction=False))
        self.full = self.interferences(model)
        """With every effect on."""
        self.model = self.full.model

    def interferences(self, model: Model) -> Interferences:
        """Errors of every reach, growing until farther pairs no longer count.

        What the farthest pairs still add stands for all that was left out.
        """
        rows, columns = model.camera.mask_shape
        unit = _row_unit(model.camera)
        # A dark line parts two that are lit: the nearest pairs would say that none interfere.
        given, model = model, DeadLines().without(model)
        reach = Reach(min(2 * unit, rows - 1), min(1, columns - 1))
        if not model.sampling.diffraction:
            reach = Reach(0, 0)
        enough = self._small
        while True:
            used = model.with_sampling(reach=reach, step=fringe_step(model, reach))
            # Light of several colours or distances blurs the fringes of one another: two samples of
            # each show how much.
            shells = self._probe.shells(used.with_sampling(wavelengths=2, layers=2))
            size = float(shells.sum((0, 1)).norm()) or 1.0
            down = float(shells[-unit:].sum((0, 1)).norm()) / size if reach.rows else 0.0
            across = float(shells[:, -1].sum(0).norm()) / size if reach.columns else 0.0
            down *= _farther(model, reach.rows // unit, (rows - 1) // unit, 0)
            across *= _farther(model, reach.columns, columns - 1, 1)
            farther = Reach(
                min(rows - 1, reach.rows + 2 * unit) if down > enough else reach.rows,
                min(columns - 1, reach.columns + 1) if across > enough else reach.columns,
            )
            many = (farther.rows // unit + 1) * (farther.columns + 1) > _MOST_SHELLS
            if farther == reach or many or not _resolved(model.with_sampling(reach=farther)):
                break
            reach = farther
        if reach.rows == rows - 1:
            down = 0.0
        if reach.columns == columns - 1:
            across = 0.0
        total = shells.sum((0, 1))
        # A sum over near pairs differs from the total by what is farther apart.
        sums = shells.cumsum(0).cumsum(1)
        errors = torch.tensor(
            [[math.hypot(relative(part, total), down, across) for part in row] for row in sums],
            dtype=torch.float64,
        )
        whole = replace(used, conditions=given.conditions)
        return Interferences(errors, collected(whole, total, (1, 2)), whole)

    @cached_property
    def ideal_filters(self) -> Interferences:
        """As :attr:`full`, with filters that leak nothing."""
        panel = replace(self.model.camera.panel, filter_leakage=0.0, filter_amplitudes=())
        return self.interferences(
            replace(self.model, camera=replace(self.model.camera, panel=panel))
        )

    def error(self, changed: Model) -> float:
        """Relative L2 of the transfer when ``changed`` takes the model's place."""
        if changed == self.model:  # shadows for shadows: what is left out is diffraction
            return self._shadow_error
        filters = _filters(changed.camera) == _filters(self.model.camera)
        channels = self._main if filters else None
        near = self._near.sampling
        changed = changed.with_sampling(reach=near.reach, step=near.step)
        transfer = self._probe.transfer(changed, channels)
        return relative(transfer, self._probe.transfer(self._near, channels))

    @cached_property
    def _near(self) -> Model:
        """The model with as much interference as the tolerance needs, to judge other effects by."""
        errors = self.full.errors
        near = (min(_row_unit(self.model.camera), errors.shape[0] - 1), 0)
        needed = [
            (rows, columns)
            for rows in range(near[0], errors.shape[0])
            for columns in range(errors.shape[1])
            if float(errors[rows, columns]) <= self.tolerance
        ]
        rows, columns = min(
            needed or [near], key=lambda pair: ((pair[0] + 1) * (2 * pair[1] + 1), pair)
        )
        reach = Reach(rows, columns)
        return self.model.with_sampling(reach=reach, step=fringe_step(self.model, reach))

    @cached_property
    def _main(self) -> list[int]:
        """The brightest channel stands for all in what is alike for all."""
        return self._probe.channels(self.model)[:1]

    def interference(self) -> float:
        """Relative L2 when no two sub-pixels interfere."""
        return float(self.full.errors[0, 0])

    def rotated(self, *, first_order: bool = False) -> float:
        """Relative L2 of ignoring the mask's rotation, or of counting it to first order."""
        return self._rotated[1 if first_order else 0]

    @cached_property
    def _rotated(self) -> tuple[float, float]:
        return self._probe.rotated(self._near)

    def sampled(self, name: str, count: int) -> float:
        """Relative L2 of ``count`` samples of ``"wavelengths"`` or ``"layers"``."""
        # Of all channels: their errors partly average out in a gray measurement.
        finest = self._probe.transfer(self._near.with_samples(name, _FINEST[name]))
        return relative(self._probe.transfer(self._near.with_samples(name, count)), finest)

    def off_axis(self, count: int | None) -> float:
        """Relative L2 with so many zones along each side; None: as if the field were flat."""
        model = self.model
        y, x = tangents(model)
        stretch_y, stretch_x = stretch(y[:, None].expand(model.scene.shape), x)
        used = replace(model, sampling=replace(model.sampling, zones=count or 1))
        errors = torch.zeros(model.scene.shape, dtype=torch.float64)
        for row in zones(used):
            for zone in row:
                here = (zone.rows, zone.columns)
                for actual, taken, slope in (
                    (stretch_y, zone.stretch[0], self._slopes[0]),
                    (stretch_x, zone.stretch[1], self._slopes[1]),
                ):
                    reference = 1.0 if count is None else taken
                    errors[here] += (slope * (actual[here] / reference).log()).square()
        fade = OffAxis().fade(model)
        if count is None:
            errors = errors + (1 / fade - 1).square()
        # The angle to a scene point is not quite the same from everywhere on mask and sensor.
        side = max(model.camera.sensor.height, model.camera.sensor.width)
        tangent = y.square()[:, None] + x.square()
        errors = errors + tangent * (4 * side / math.sqrt(12) / model.scene.distance) ** 2
        return min(1.0, float(((errors * fade.square()).mean() / fade.square().mean()).sqrt()))

    @cached_property
    def _slopes(self) -> tuple[float, float]:
        """Relative change of the transfer per relative change of the wavelength along y and x."""
        base = self._probe.transfer(self._near, self._main)
        return tuple(  # type: ignore[return-value]
            relative(self._probe.transfer(self._near, self._main, stretch), base) / math.log(1.02)
            for stretch in ((1.02, 1.0), (1.0, 1.02))
        )

    @cached_property
    def _white(self) -> tuple[Probe, Tensor]:
        """A probe for one scene pixel as large as the scene, and what it gives."""
        scene = self.model.scene
        side = scene.pixel * math.sqrt(scene.rows * scene.columns)
        model = replace(self.model, scene=replace(scene, rows=1, columns=1, height=side))
        model = model.with_sampling(reach=Reach(0, 0))
        probe = Probe(model)
        shares = model.camera.sensor.channel_weights
        channels = [
            probe.transfer(model, [channel]) / share if share else None
            for channel, share in enumerate(shares)
        ]
        dark = torch.zeros(
            len(probe.masks), len(probe.kept_y), len(probe.kept_x), dtype=torch.float64
        )
        return probe, torch.stack([dark if values is None else values for values in channels])

    def values(self) -> Tensor:
        """Noiseless embeddings of a white scene through each channel, (3, masks, rows, columns)."""
        return self._white[1]

    def kept(self) -> tuple[Tensor, Tensor]:
        """Which embedding rows and columns :meth:`values` holds."""
        return self._white[0].kept_y, self._white[0].kept_x

    def paraxial(self) -> float:
        """Relative L2 of Fresnel's approximation, which every factored field makes.

        Light that leaves an aperture at an angle theta is wrong by about theta^2 / 2, and by half
        the phase pi d theta^4 / 4 lambda where it interferes (Goodman, section 4.2.2). No angle is
        larger than diffraction makes it, or than the sensor sees. Against exact light this is 1 to
        5 times the error.
        """
        camera = actual_camera(self.model)
        if not self.model.sampling.diffraction:
            return 0.0
        panel, distance = camera.panel, camera.distance
        wavelength = max(camera.wavelengths)
        height, width = camera.lit_sides(self.model.scene)
        seen = max(
            height + camera.window.rows * panel.pitch_y,
            width + camera.window.columns * panel.pitch_x,
        )
        angle = min(
            wavelength / min(panel.aperture_y, panel.aperture_x), seen / 2 / distance, math.pi / 2
        )
        phase = math.pi / 4 * distance / min(camera.wavelengths) * angle**4
        return min(1.0, math.hypot(angle**2, min(1.0, phase) * self.interference()) / 2)

    def quadrature(self, model: Model) -> tuple[float, float]:
        """Largest step [m] whose integration error is far below the tolerance, and that error.

        The step has to resolve the fringes of the farthest pairs; below that the error falls with
        its square.
        """
        if not model.sampling.diffraction:
            return model.sampling.step, 0.0
        step = fringe_step(model, model.sampling.reach)
        error = math.inf
        for _ in range(4):
            coarse = model.with_sampling(step=step, wavelengths=1, layers=1)
            fine = coarse.with_sampling(step=step / 2)
            reference = self._probe.transfer(fine, self._main)
            error = 4 / 3 * relative(self._probe.transfer(coarse, self._main), reference)
            if error <= self._small:
                break
            wanted = step * max(0.2, 0.8 * math.sqrt(self._small / error))
            if wanted < _smallest_step(model):
                break
            step = wanted
        return step, error

    def grid(self, oversampling: float) -> float:
        """Relative L2 of the grid path; 1 where it cannot work."""
        camera, scene = actual_camera(self.model), self.model.scene
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
        embedding = self.model.embedding
        pixel = min(sensor.height / embedding.rows, sensor.width / embedding.columns)
        error = _GRID_ERROR / cells_in_aperture(camera, oversampling) ** _GRID_ORDER
        aperture = min(panel.aperture_y, panel.aperture_x)
        spread = max(camera.wavelengths) * camera.distance / aperture
        # Errors of cells average out over larger pixels, not over smaller ones.
        widest = max(1.0, 2 * cell / (pixel + image), _GRID_SPREAD * spread / (pixel + image))
        return float(min(1.0, error * widest))


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


def _farther(model: Model, looked_at: int, there: int, axis: int) -> float:
    """How much all that is farther apart adds, times the farthest that was looked at.

    Random masks: shells add up in quadrature. Averaged over a box, fringes fall with the inverse of
    what is apart, so that all beyond the n-th are at most sqrt(n) times the n-th; where they are
    wider than the box they do not fall, and every shell that is there may be as large.
    """
    camera = actual_camera(model)
    panel, sensor, embedding = camera.panel, camera.sensor, model.embedding
    pitch = (panel.pitch_y, panel.pitch_x)[axis]
    pixel = (sensor.height / embedding.rows, sensor.width / embedding.columns)[axis]
    box = max(pixel, model.scene.pixel_at_sensor(camera))
    left = max(0, there - looked_at)
    fringe = max(camera.wavelengths) * camera.distance / (max(1, looked_at) * pitch)
    return math.sqrt(left if fringe > box else min(left, looked_at))


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
    return max(wanted, _smallest_step(model))


def _resolved(model: Model) -> bool:
    return fringe_step(model, model.sampling.reach) > 1.01 * _smallest_step(model)


def _smallest_step(model: Model) -> float:
    """Below it the fields would take too much memory [m]."""
    rows, columns = model.camera.mask_shape
    nodes_y, nodes_x = nodes(model.with_sampling(step=1.0e-6))
    return 1.0e-6 * max(nodes_y * rows, nodes_x * columns) / MAX_VALUES


def _filters(camera: Camera) -> tuple[object, ...]:
    panel = camera.panel
    return panel.filter_cycle, panel.filter_leakage, panel.filter_amplitudes


def _row_unit(camera: Camera) -> int:
    """Rows between the nearest two that interfere at all."""
    for apart in range(1, camera.window.rows):
        for channel in range(3):
            amplitudes = camera.row_amplitudes(channel)
            if any(a * b for a, b in zip(amplitudes, amplitudes[apart:], strict=False)):
                return apart
    return 1
