"""The grid's own error: grids that are finer and finer, against one another.

A grid misplaces what its cells cut: edges of apertures. What that does depends on where edges lie
among the cells and on what of them the sensor sees, so that it is measured, turned masks included.
"""

import math
from dataclasses import replace
from functools import cached_property

import torch
from torch import Tensor

from veilcam_optics.effects.mask import actual_camera
from veilcam_optics.effects.model import Model
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan.cost import cost
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.grid import cells_in_aperture, sample_pitch

OVERSAMPLINGS = (1.0, 2.0, 4.0, 8.0)
"""Times the coarsest."""

_FINER = 2.0
_LEFT = 0.62
"""Of a grid's error with cells half as wide, at worst: its 0.7th power; see ``grid_error``."""

_GRID_ERROR, _GRID_ORDER, _GRID_SPREAD = 0.105, 0.7, 5.5
"""The grid's error is about 0.105 / (samples across an aperture)^0.7: cells cut apertures.

Light that they misplace stays in its pixel where pixels are wide; else it is wrong by 5.5 times
as much as diffraction spreads it, in pixels. Measured for apertures of 6 to 60 um, 0.2 to 4 mm
before the sensor, 2 to 40 samples across: within a factor of 2, but for less error at 2 to 4.
"""

_PIXELS, _MASKS = 6, 2
_MOST_MS = 400.0
"""What the finest grid that is looked at may take, as plans predict it."""


class GridErrors:
    """Relative L2 of grids for light along the axis, apart from what Fresnel's approximation has.

    Args:
        model: model of the grid method, with every effect that it has.
        least: coarsest oversampling.
        masks: amplitudes asked of the panel, (masks, rows, columns).
    """

    def __init__(self, model: Model, least: float, masks: Tensor) -> None:
        self._model = model.with_sampling(wavelengths=1, layers=1, zones=1, dtype=torch.float64)
        self._least, self._masks = least, masks[:_MASKS]

    def at(self, oversampling: float) -> float:
        """Return the error of one grid; 1 where it cannot work, or more where it is too bright."""
        fitted = grid_error(self._model, oversampling)
        found = self._transfers
        if len(found) < 2:
            return fitted
        measured = self._measured(oversampling, found)
        return max(fitted, measured) if fitted >= 1 else measured

    def _measured(self, oversampling: float, found: dict[float, Tensor]) -> float:
        finer = list(found)
        size = float(found[finer[-1]].norm())
        last = float((found[finer[-1]] - found[finer[-2]]).norm())
        if not size:
            return 1.0
        # Of a series of errors that shrink by a factor: the last, from the last difference.
        left = _LEFT / (1 - _LEFT) * last / size
        if oversampling not in found:
            beyond = OVERSAMPLINGS.index(oversampling / self._least) - len(finer) + 1
            return min(1.0, left * _LEFT**beyond)
        apart = float((found[oversampling] - found[finer[-1]]).norm()) / size
        return min(1.0, max(apart, left)) if oversampling == finer[-1] else apart + min(1.0, left)

    @cached_property
    def _transfers(self) -> dict[float, Tensor]:
        """Some rows of transfers by oversampling, from the coarsest to as fine as is affordable."""
        scene = self._model.scene
        pixels = scene.rows * scene.columns
        at = ((torch.arange(min(_PIXELS, pixels)) + 0.5) * pixels / min(_PIXELS, pixels)).long()
        lit = torch.zeros(len(at), pixels, dtype=torch.float64)
        lit[torch.arange(len(at)), at] = 1
        scenes = lit.reshape(-1, *scene.shape)
        found: dict[float, Tensor] = {}
        for factor in (*OVERSAMPLINGS, OVERSAMPLINGS[-1] * _FINER):
            oversampling = factor * self._least
            sampling = replace(self._model.sampling, oversampling=oversampling)
            model = replace(self._model, sampling=sampling)
            if cost(model, len(at)).step_ms * len(self._masks) > _MOST_MS:
                break
            try:
                operator = LightOperator(model)
            except OpticsError:  # more than fits in memory
                break
            with torch.no_grad():
                found[oversampling] = torch.stack(
                    [operator.collect(scenes, operator.response(mask)) for mask in self._masks]
                )
        return found


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
    pixel = min(model.embedding.box(sensor))
    error = _GRID_ERROR / cells_in_aperture(camera, oversampling) ** _GRID_ORDER
    aperture = min(panel.aperture_y, panel.aperture_x)
    spread = max(camera.wavelengths) * camera.distance / aperture
    # Errors of cells average out over larger pixels, not over smaller ones.
    widest = max(1.0, 2 * cell / (pixel + image), _GRID_SPREAD * spread / (pixel + image))
    return float(min(1.0, error * widest))
