"""How a real panel departs from an ideal one, so that training can expect it."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.operator import Reach, TransferOperator, Variables
from veilcam_training.encoders.base import Setup


class PanelErrors(BaseModel):
    """Largest errors of a panel; each step of training draws its own up to these. All 0: none."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    gamma: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Departure from 1 of the exponent between weight shown and weight wanted, to either side."""
    floor: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Amplitude that a closed sub-pixel still passes: the reciprocal root of the contrast ratio."""
    shift: Annotated[float, Field(ge=0, le=1e-2)] = 0.0
    """Displacement of the panel along each axis, to either side [m]."""
    distance: Annotated[float, Field(ge=0, le=1e-2)] = 0.0
    """Error of the distance from panel to sensor, to either side [m]."""
    places: Annotated[int, Field(ge=1, le=64)] = 8
    """How many displacements are prepared to draw from."""

    @property
    def moves(self) -> bool:
        """True if the panel may be displaced."""
        return self.shift > 0 or self.distance > 0

    @property
    def any(self) -> bool:
        """True if anything may be wrong at all."""
        return self.moves or self.gamma > 0 or self.floor > 0

    def shown(self, weights: Tensor) -> Tensor:
        """What a panel with a gamma and a floor drawn at random shows for ``weights``, > 0."""
        if self.gamma:
            weights = weights ** (1 + self.gamma * float(2 * torch.rand(1) - 1))
        if self.floor:
            floor = self.floor * float(torch.rand(1))
            weights = floor + (1 - floor) * weights
        return weights


def make_operators(
    setup: Setup, *, shift: tuple[float, float] = (0.0, 0.0), distance_error: float = 0.0
) -> tuple[TransferOperator, ...]:
    """Transfer operators of ``setup``, one for each grid, with the panel out of place.

    A point reading averages the fringes over a scene pixel's image alone, which is several times
    smaller than an embedding pixel: neighbouring columns and rows of one colour count there too.

    Args:
        setup: camera, scene and reading.
        shift: of the panel along y and x [m].
        distance_error: added to the distance from panel to sensor [m].
    """
    camera = replace(setup.camera, distance=setup.camera.distance + distance_error)
    y, x = (torch.tensor(value, dtype=torch.float64) for value in shift)
    return tuple(
        TransferOperator(
            camera,
            scene,
            setup.embedding,
            colour=setup.colour,
            reach=Reach(3, 1) if setup.point_reading else Reach(),
            approximation=Approximation(point_reading=setup.point_reading),
            variables=Variables(shift_y=y, shift_x=x),
        )
        for scene in setup.grids
    )


def make_places(
    setup: Setup, errors: PanelErrors, generator: torch.Generator
) -> tuple[tuple[TransferOperator, ...], ...]:
    """Operators of the ideal place, and of ``errors.places`` others drawn at random."""
    operators = [make_operators(setup)]
    if errors.moves:
        draws = 2 * torch.rand(errors.places, 3, generator=generator, dtype=torch.float64) - 1
        for y, x, along in draws.tolist():
            operators.append(
                make_operators(
                    setup,
                    shift=(errors.shift * y, errors.shift * x),
                    distance_error=errors.distance * along,
                )
            )
    return tuple(operators)
