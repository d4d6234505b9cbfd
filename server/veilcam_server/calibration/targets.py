"""Scenes that are set before a camera to measure it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from veilcam_client.wire.calibration import SceneName
from veilcam_optics.camera.geometry import Scene

_LAMP = 7
"""A lamp takes one part in so many of each side of the scene."""


@dataclass(frozen=True, eq=False, slots=True)
class CalibrationScene:
    """A scene that a person can make.

    Attributes:
        name: short.
        instruction: how to make it.
        image: what it is, reflectances in [0, 1], shape of the scene.
    """

    name: SceneName
    instruction: str
    image: npt.NDArray[np.float32] = field(repr=False)


def dark(scene: Scene) -> CalibrationScene:
    """No light at all."""
    return CalibrationScene(
        "dark",
        "Cover the camera so that no light gets in.",
        np.zeros(scene.shape, np.float32),
    )


def white(scene: Scene) -> CalibrationScene:
    """A card that fills the scene."""
    height, width = (100 * scene.pixel * count for count in scene.shape)
    return CalibrationScene(
        "white card",
        f"Hold up a white card, {width:.3g} cm wide and {height:.3g} cm high, evenly lit and "
        f"upright before black, {100 * scene.distance:.3g} cm in front of the panel, its middle "
        "on the camera's axis.",
        np.ones(scene.shape, np.float32),
    )


def lamp(scene: Scene) -> CalibrationScene:
    """A small bright square in the middle of where the card was."""
    sides = tuple(_lamp_side(count) for count in scene.shape)
    image = np.zeros(scene.shape, np.float32)
    rows, columns = (
        slice((count - side) // 2, (count + side) // 2)
        for count, side in zip(scene.shape, sides, strict=True)
    )
    image[rows, columns] = 1.0
    height, width = (1000 * scene.pixel * side for side in sides)
    return CalibrationScene(
        "lamp",
        f"Put a lamp behind a hole of {width:.3g} x {height:.3g} mm in black card, the hole where "
        "the middle of the white card was; no other light.",
        image,
    )


def _lamp_side(count: int) -> int:
    """Pixels of the lamp along a side: even where the scene's are, so that it has a middle."""
    side = max(1, count // _LAMP)
    return side if side % 2 == count % 2 else side + 1
