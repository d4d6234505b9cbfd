"""Where in the field of view an image is shown."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Scene


@dataclass(frozen=True)
class Placement:
    """Shows images of shape ``image`` in a scene that is as large or larger."""

    image: Scene
    scene: Scene

    @classmethod
    def centred(cls, image: Scene) -> Placement:
        """The image is the scene."""
        return cls(image, image)

    @classmethod
    def anywhere(cls, image: Scene, camera: Camera, multiple: int = 1) -> Placement:
        """The scene is all that the sensor's geometric image holds.

        Its sides are the nearest multiples of ``multiple`` pixels.
        """
        pixel = image.pixel_at_sensor(camera)
        rows, columns = (
            multiple * round(side / pixel / multiple)
            for side in (camera.sensor.height, camera.sensor.width)
        )
        scene = Scene(rows, columns, rows * image.pixel, image.distance)
        return cls(image, scene)

    def place(self, images: Tensor, generator: torch.Generator) -> Tensor:
        """Scenes with each image at its own place, drawn uniformly; the rest is black.

        Args:
            images: (batch, rows, columns).
            generator: source of the random numbers.

        Returns:
            (batch, scene rows, scene columns).
        """
        if self.scene.shape == self.image.shape:
            return images
        rows, columns = self.image.shape
        free_rows, free_columns = self.scene.rows - rows, self.scene.columns - columns
        tops = torch.randint(free_rows + 1, (len(images),), generator=generator)
        lefts = torch.randint(free_columns + 1, (len(images),), generator=generator)
        scenes = images.new_zeros(len(images), *self.scene.shape)
        for scene, image, top, left in zip(
            scenes, images, tops.tolist(), lefts.tolist(), strict=True
        ):
            scene[top : top + rows, left : left + columns] = image
        return scenes
