"""A scene covered with another one for a while."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from veilcam_server.devices.held_scene import HeldScene


class Ones:
    def read(self) -> npt.NDArray[np.float32]:
        return np.ones((2, 3), np.float32)


def test_what_is_held_up_covers_what_is_there() -> None:
    scene = HeldScene(Ones())
    assert scene.read().mean() == 1
    scene.hold(np.zeros((2, 3), np.float32))
    assert scene.read().mean() == 0
    scene.hold(None)
    assert scene.read().mean() == 1
