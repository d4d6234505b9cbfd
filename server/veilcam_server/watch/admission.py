"""Admission of captures to the watch: bright enough, and like the scenes to be expected.

Two numbers of a capture tell (:class:`~veilcam_server.masks.source.Evidence`): its light, and its
novelty, which a bundle without scene statistics does not have.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from veilcam_client.wire.calibration import CalibrationRecord
from veilcam_server.masks.source import Evidence

_DEVIATIONS = 10
"""Standard uncertainties of the black level that are no light yet."""
_TRANSMITTANCE = 1 / 3
"""Of a mask in the mean, where every weight is as likely as any other."""


@dataclass(frozen=True, slots=True)
class Admission:
    """Thresholds: what is beyond either looks like nothing that is known.

    The defaults are those of the simulated camera: docs/watch.md says between what they lie.

    Raises:
        ValueError: a threshold that cannot be.
    """

    least_light: float = 0.002
    """As of :attr:`Evidence.light`."""
    most_novelty: float = 7.0
    """As of :attr:`Evidence.novelty`."""

    def __post_init__(self) -> None:
        for name in ("least_light", "most_novelty"):
            threshold = getattr(self, name)
            if not (math.isfinite(threshold) and threshold > 0):
                raise ValueError(f"{name} = {threshold} is not valid: use a number > 0")

    def admits(self, evidence: Evidence) -> bool:
        """Return whether a capture looks like one of a thing."""
        familiar = evidence.novelty is None or evidence.novelty <= self.most_novelty
        return familiar and evidence.light >= self.least_light

    def calibrated(self, record: CalibrationRecord) -> Admission:
        """Return the limits for a camera whose black level was measured, with its uncertainty.

        Args:
            record: record of a calibration, whose covered camera is an empty scene.
        """
        unsure = record.black_level.uncertainty / record.gain.value / _TRANSMITTANCE
        return replace(self, least_light=max(self.least_light, _DEVIATIONS * unsure))
