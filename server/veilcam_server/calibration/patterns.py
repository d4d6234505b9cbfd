"""Patterns that a camera is measured with. They are no secret, and never masks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from veilcam_optics.camera.geometry import Camera
from veilcam_server.devices.protocols import Levels

_BLOCK = 0.4e-3
"""Side of the squares of coarse patterns [m]: two embedding pixels, so that a fit finds a mask that
is that far off."""


@dataclass(frozen=True, slots=True)
class Patterns:
    """How many of each kind."""

    coarse: int = 4
    """Squares, open or opaque: for the first fit."""
    fine: int = 8
    """Sub-pixels, open or opaque: for the second."""
    held_out: int = 3
    """Sub-pixels of any level, which no fit sees: for the verdict."""

    @property
    def count(self) -> int:
        """Readings of one scene; an opaque one is among them."""
        return 1 + self.coarse + self.fine + self.held_out

    def draw(self, camera: Camera) -> list[Levels]:
        """Opaque, coarse, fine, held out; the same ones every time."""
        random = np.random.default_rng(1)
        top, (rows, columns) = camera.panel.levels - 1, camera.mask_shape
        high, wide = (
            max(1, round(_BLOCK / pitch)) for pitch in (camera.panel.pitch_y, camera.panel.pitch_x)
        )

        def squares() -> Levels:
            blocks = random.integers(0, 2, (-(-rows // high), -(-columns // wide)), np.uint8)
            return (top * blocks).repeat(high, 0).repeat(wide, 1)[:rows, :columns]

        return [
            np.zeros((rows, columns), np.uint8),
            *(squares() for _ in range(self.coarse)),
            *(top * random.integers(0, 2, (rows, columns), np.uint8) for _ in range(self.fine)),
            *(random.integers(0, top + 1, (rows, columns), np.uint8) for _ in range(self.held_out)),
        ]
