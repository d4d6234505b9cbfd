"""Light behind the panel as planned, and imperfections that are drawn at random for training."""

from dataclasses import replace
from functools import lru_cache
from typing import Annotated

import torch
from pydantic import BaseModel, Field
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections, Spreads
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.plan import Plan, plan
from veilcam_optics.simulation.operator import LightOperator
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


def plan_light(setup: Setup) -> tuple[Plan, ...]:
    """Return the plan of the light on each grid; none for a measurement at points."""
    if setup.point_binning:
        return ()
    return tuple(
        _planned(setup.camera, scene, setup.embedding, setup.tolerance) for scene in setup.grids
    )


@lru_cache(maxsize=64)
def _planned(camera: Camera, scene: Scene, embedding: Embedding, tolerance: float) -> Plan:
    """Return a plan; every place and every pair of one setup has the same.

    Pixels that are black in all images of a step are left out of its products. So a plan for its
    whole batch would take zones for cheaper than they are: it is made for the default one.
    """
    return plan(camera, scene, embedding, tolerance, method="transfer")


def make_operators(
    setup: Setup, imperfections: Imperfections = NOMINAL
) -> tuple[LightOperator, ...]:
    """Operators of the light as planned, one for each grid, with the panel out of place.

    No plan reads the sensor at points. That averages the fringes over a scene pixel's image alone,
    which is several times smaller than an embedding pixel: neighbouring columns and rows of one
    colour count there too.

    Args:
        setup: camera, scene and measurement.
        imperfections: imperfections of the camera as built.
    """
    points = Sampling(binning=False, reach=Reach(3, 1))
    models = [planned.model for planned in plan_light(setup)] or [
        Model(setup.camera, scene, setup.embedding, sampling=points) for scene in setup.grids
    ]
    return tuple(
        LightOperator(
            replace(model, conditions=replace(model.conditions, imperfections=imperfections)),
            colour=setup.colour,
        )
        for model in models
    )


def make_places(
    setup: Setup, errors: PanelErrors, generator: torch.Generator
) -> tuple[tuple[LightOperator, ...], ...]:
    """Operators of the ideal place, and of ``errors.places`` others drawn at random."""
    spreads = Spreads(shift=errors.shift, distance=errors.distance)
    drawn = [
        Imperfections.sample(spreads, generator)
        for _ in range(errors.places if errors.moves else 0)
    ]
    return tuple(make_operators(setup, imperfections) for imperfections in (NOMINAL, *drawn))
