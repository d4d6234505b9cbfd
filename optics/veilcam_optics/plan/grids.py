"""The grid's own error: grids that are finer and finer, against one another.

A grid misplaces what its cells cut: edges of apertures. What that does depends on where edges lie
among the cells and on what of them the sensor sees, so that it is measured, turned masks included.
"""

from dataclasses import replace
from functools import cached_property

import torch
from torch import Tensor

from veilcam_optics.effects.model import Model
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan.bounds import grid_error
from veilcam_optics.plan.cost import cost
from veilcam_optics.simulation.operator import LightOperator

OVERSAMPLINGS = (1.0, 2.0, 4.0, 8.0)
"""Times the coarsest."""

_FINER = 2.0
_LEFT = 0.62
"""Of a grid's error with cells half as wide, at worst: its 0.7th power; see ``grid_error``."""

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
