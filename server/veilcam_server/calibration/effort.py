"""How much a calibration reads."""

from __future__ import annotations

from dataclasses import dataclass, field

from veilcam_server.calibration.geometry import Geometry
from veilcam_server.calibration.patterns import Patterns
from veilcam_server.calibration.response import STEPS


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is read."""

    repeats: int = 2
    """Exposures for one reading."""
    samples: int = 10
    """Of each step of settling, in each of two passes."""
    patterns: Patterns = field(default_factory=Patterns)

    def captures(self, geometry: Geometry) -> int:
        """How many exposures a calibration takes."""
        single = 3 + 2 + sum(geometry.camera.mask_shape) + 1 + STEPS + 2 * self.patterns.count
        return 1 + 8 * self.samples + self.repeats * single
