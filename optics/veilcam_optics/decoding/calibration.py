"""How a camera that was built departs from its drawing, as far as a decoder can take it in."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.camera.masks import respond
from veilcam_optics.errors import invalid
from veilcam_optics.transfer.operator import Reach, TransferOperator, Variables


def with_dead_rows(weights: Tensor, rows: Iterable[int], transmittance: float = 0.0) -> Tensor:
    """Weights as a panel shows them whose ``rows`` are stuck.

    Args:
        weights: amplitude transmittances, (rows, columns).
        rows: mask rows that do not obey, from 0.
        transmittance: amplitude that a stuck row passes, in [0, 1]; 0 is dark.

    Returns:
        A copy with those rows replaced.

    Raises:
        OpticsError: a row that the mask does not have, or no transmittance.
    """
    dead = sorted(set(rows))
    if dead and not 0 <= dead[0] <= dead[-1] < weights.shape[0]:
        raise invalid("rows", dead, "", f"mask rows 0 to {weights.shape[0] - 1}")
    if not 0 <= transmittance <= 1:
        raise invalid("transmittance", transmittance, "", "0 to 1")
    shown = weights.clone()
    shown[dead] = transmittance
    return shown


@dataclass(frozen=True, slots=True)
class Calibration:
    """Where the panel sits, and what it shows of what it is told. By default as drawn.

    Attributes:
        shift_y: displacement of the mask along y [m].
        shift_x: displacement of the mask along x [m].
        rotation: of the mask around the axis, from x towards y [rad]; small.
        distance_error: how much farther than ``camera.distance`` the sensor is [m].
        gamma: the panel shows the amplitude ``w^gamma``.
        contrast_floor: amplitude of a sub-pixel that is told to be dark.
        dead_rows: mask rows that do not obey, from 0.
        dead_columns: mask columns that do not obey, from 0.
        dead_transmittance: amplitude that those pass.

    Raises:
        OpticsError: a number that no camera can have.
    """

    shift_y: float = 0.0
    shift_x: float = 0.0
    rotation: float = 0.0
    distance_error: float = 0.0
    gamma: float = 1.0
    contrast_floor: float = 0.0
    dead_rows: tuple[int, ...] = ()
    dead_columns: tuple[int, ...] = ()
    dead_transmittance: float = 0.0

    def __post_init__(self) -> None:
        Conditions(
            shift_y=self.shift_y,
            shift_x=self.shift_x,
            rotation=self.rotation,
            distance_error=self.distance_error,
            gamma=self.gamma,
            contrast_floor=self.contrast_floor,
        )
        if not 0 <= self.dead_transmittance <= 1:
            raise invalid("dead_transmittance", self.dead_transmittance, "", "0 to 1")

    def shown(self, weights: Tensor) -> Tensor:
        """Amplitudes that the panel shows when it is told ``weights``, same shape.

        Raises:
            OpticsError: a dead row or column that the mask does not have.
        """
        shown = respond(weights, gamma=self.gamma, contrast_floor=self.contrast_floor)
        if self.dead_rows:
            shown = with_dead_rows(shown, self.dead_rows, self.dead_transmittance)
        if self.dead_columns:
            shown = with_dead_rows(shown.T, self.dead_columns, self.dead_transmittance).T
        return shown

    def operator(
        self,
        camera: Camera,
        scene: Scene,
        embedding: Embedding,
        *,
        reach: Reach = Reach(),  # noqa: B008 - immutable
        dtype: torch.dtype = torch.float32,
    ) -> TransferOperator:
        """The transfer operator of the camera as it was built; it takes what the panel *shows*.

        Raises:
            OpticsError: the sensor would lie in front of the panel.
        """
        if self.distance_error:
            camera = replace(camera, distance=camera.distance + self.distance_error)
        return TransferOperator(
            camera,
            scene,
            embedding,
            reach=reach,
            dtype=dtype,
            variables=Variables(
                shift_y=torch.tensor(self.shift_y, dtype=torch.float64),
                shift_x=torch.tensor(self.shift_x, dtype=torch.float64),
            ),
            rotation=self.rotation,
        )


AS_DRAWN = Calibration()
"""A camera that is what its drawing says."""
