"""Imperfections drawn at random, so that training can expect a real panel."""

from typing import Annotated

import torch
from pydantic import BaseModel, Field
from torch import Tensor

from veilcam_optics.camera.imperfections import NOMINAL, Imperfections, Spreads
from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach
from veilcam_training.encoders.base import Setup


class PanelErrors(BaseModel, frozen=True, extra="forbid", strict=True):
    """Largest errors of a panel; each step of training draws its own up to these. All 0: none."""

    gamma: Annotated[float, Field(ge=0, le=0.9)] = 0.0
    """Departure from 1 of the exponent between weight shown and weight wanted, to either side."""
    floor: Annotated[float, Field(ge=0, le=0.99)] = 0.0
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
        """Return the weights that a panel with a random gamma and floor shows for ``weights``."""
        spreads = Spreads(gamma=self.gamma, contrast_floor=self.floor)
        return Imperfections.sample(spreads).shown(weights)


def make_operators(
    setup: Setup, imperfections: Imperfections = NOMINAL
) -> tuple[TransferOperator, ...]:
    """Transfer operators of ``setup``, one for each grid, with the panel out of place.

    A point binning averages the fringes over a scene pixel's image alone, which is several times
    smaller than an embedding pixel: neighbouring columns and rows of one colour count there too.

    Args:
        setup: camera, scene and measurement.
        imperfections: imperfections of the camera as built.
    """
    return tuple(
        TransferOperator(
            setup.camera,
            scene,
            setup.embedding,
            colour=setup.colour,
            reach=Reach(3, 1) if setup.point_binning else Reach(),
            approximation=Approximation(point_binning=setup.point_binning),
            imperfections=imperfections,
        )
        for scene in setup.grids
    )


def make_places(
    setup: Setup, errors: PanelErrors, generator: torch.Generator
) -> tuple[tuple[TransferOperator, ...], ...]:
    """Operators of the ideal place, and of ``errors.places`` others drawn at random."""
    spreads = Spreads(shift=errors.shift, distance=errors.distance)
    drawn = [
        Imperfections.sample(spreads, generator)
        for _ in range(errors.places if errors.moves else 0)
    ]
    return tuple(make_operators(setup, imperfections) for imperfections in (NOMINAL, *drawn))
