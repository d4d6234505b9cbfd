"""Where in the field of view an image is shown."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Scene
from veilcam_training.transforms.scene import Change, Shift, Shown


class Anywhere(Shift):
    """Every image at a place of its own, in training too, in all that the sensor sees.

    Args:
        image: how large and how far away images are shown.
        camera: whose geometric image of the scene the sensor holds.
        multiple: the scene's sides are the nearest multiples of so many pixels.
    """

    def __init__(self, image: Scene, camera: Camera, multiple: int = 1) -> None:
        pixel = image.pixel_at_sensor(camera)
        rows, columns = (
            multiple * round(side / pixel / multiple)
            for side in (camera.sensor.height, camera.sensor.width)
        )
        Change.__init__(self, replace(image, rows=rows, columns=columns, height=rows * image.pixel))

    def in_parts(
        self, images: Tensor, generator: torch.Generator, *, training: bool
    ) -> Iterator[Shown]:
        """All scenes at once."""
        return Change.in_parts(self, images, generator, training=training)
