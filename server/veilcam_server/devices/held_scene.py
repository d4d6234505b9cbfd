"""What is held up before a simulated camera, over what is in front of it anyway."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from veilcam_server.devices.scene import SceneSource


class HeldScene:
    """A scene that somebody within the daemon may cover with another one for a while.

    Args:
        source: what is seen while nothing is held up.
    """

    def __init__(self, source: SceneSource) -> None:
        self._source = source
        self._held: npt.NDArray[np.float32] | None = None

    def hold(self, image: npt.NDArray[np.float32] | None) -> None:
        """Hold up reflectances in [0, 1], shape of the scene; None takes them away."""
        self._held = image

    def read(self) -> npt.NDArray[np.float32]:
        """Return what is seen; raises as the source does where nothing is held up."""
        held = self._held
        return self._source.read() if held is None else held
