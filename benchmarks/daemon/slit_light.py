"""Light of a simulated camera by slits and Fresnel integrals, as :mod:`benchmarks.proof` has it.

It shares no code with the optics of the daemon, and takes milliseconds where a plan's waves take
most of a second for each mask.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from benchmarks.proof.light import CHANNELS, Field, Singles, Slits, centred

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.simulation.operator import Response
from veilcam_server.devices.simulated.device import raw_shape


class SlitLight:
    """Light of a camera as it was drawn, from a scene through its window to raw pixels.

    Args:
        camera: its panel, window and sensor.
        scene: in front of it.
        embedding: that raw pixels are binned to.
    """

    def __init__(self, camera: Camera, scene: Scene, embedding: Embedding) -> None:
        self._weights = camera.sensor.channel_weights
        self._filters = [np.square(camera.row_amplitudes(channel)) for channel in CHANNELS]
        pixels, panel, sensor = raw_shape(embedding), camera.panel, camera.sensor
        slits = (
            Slits(np.array(centres), width, side, count, _field(lines, camera, scene))
            for centres, width, side, count, lines in zip(
                (camera.row_centres, camera.column_centres),
                (panel.aperture_y, panel.aperture_x),
                (sensor.height, sensor.width),
                pixels,
                scene.shape,
                strict=True,
            )
        )
        self._down, self._across = (
            [each.factors(((wavelength, 1.0),))[0] for wavelength in camera.wavelengths]
            for each in slits
        )

    def response(self, weights: torch.Tensor) -> Response:
        """What a mask makes of the light: for each channel, (scene rows, pixel rows, mask columns).

        Args:
            weights: amplitudes that the window passes, (rows, columns).
        """
        passed = np.square(weights.numpy())
        return tuple(
            torch.from_numpy((down @ (own[:, None] * passed)).astype(np.float32))
            for down, own in zip(self._down, self._filters, strict=True)
        )

    def collect(self, scenes: torch.Tensor, response: Response) -> torch.Tensor:
        """Light on the pixels: (scenes, rows, columns).

        Args:
            scenes: (scenes, rows, columns), 1 where they are white.
            response: of the mask.
        """
        seen = [self._collected(scene, response) for scene in scenes.numpy()]
        return torch.from_numpy(np.stack(seen))

    def _collected(self, scene: npt.NDArray[np.float32], response: Response) -> Singles:
        light = np.zeros((self._down[0].shape[1], self._across[0].shape[1]), np.float32)
        for weight, rows, across in zip(self._weights, response, self._across, strict=True):
            # Behind each row of the scene: (pixel columns, mask columns).
            behind = np.tensordot(scene, across, 1)
            light += np.float32(weight) * np.einsum(
                "yrc,yxc->rx", rows.numpy(), behind, optimize=True
            )
        return light


def _field(lines: int, camera: Camera, scene: Scene) -> Field:
    """Directions of the lines of a scene."""
    square = scene.height / scene.distance
    step = scene.pixel / scene.distance
    return Field(centred(lines) * step, square, camera.distance, scene.distance)
