"""Simulation of a device: the scene before it, and its faults."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from veilcam_client.wire.simulation import Faults
from veilcam_optics.pictures import PictureError
from veilcam_server.devices.simulated.images import as_scene, decoded, range_warning
from veilcam_server.devices.simulated.scenes import Scenes
from veilcam_server.errors import ProblemError


class Simulation:
    """Scenes and faults of a simulated device, for callers who may set them.

    Args:
        scenes: scenes before which pictures are held up.
        break_device: breaks and mends the device.
    """

    def __init__(self, scenes: Scenes, break_device: Callable[[Faults], None]) -> None:
        self.scenes, self.break_device = scenes, break_device

    def picture(self, content: bytes) -> tuple[npt.NDArray[np.float32], str | None]:
        """Return a picture of the scene's size, and a warning.

        Raises:
            ProblemError: it is no picture.
        """
        try:
            picture = decoded(content)
            scene, warning = as_scene(picture, self.scenes.shape), range_warning(picture)
        except PictureError as error:
            raise ProblemError("invalid_request", f"this {error}") from None
        fitted = scene if scene.ndim == 2 else np.moveaxis(scene, 0, 2)
        return fitted, None if warning is None else f"this {warning}"
