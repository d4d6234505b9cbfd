"""A sensor whose readings are those that decoders expect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from veilcam_server.devices.protocols import Exposure, Reading, Sensor


class CalibratedSensor:
    """Takes the black level off and the gain out of every reading.

    Args:
        sensor: closed with this.
        black_level: its reading without light.
        gain: its reading where a decoder expects 1.
    """

    def __init__(self, sensor: Sensor, *, black_level: float, gain: float) -> None:
        self._sensor, self._black_level, self._gain = sensor, black_level, gain

    @property
    def name(self) -> str:
        """Of the sensor."""
        return self._sensor.name

    @property
    def full_scale(self) -> float:
        """Reading of saturated pixels."""
        return (self._sensor.full_scale - self._black_level) / self._gain

    def capture(self, not_before: float, timeout: float) -> Exposure:
        """As the sensor does."""
        exposure = self._sensor.capture(not_before, timeout)
        corrected: Reading = (
            (exposure.embedding.astype(np.float64) - self._black_level) / self._gain
        ).astype(np.float32)
        return replace(exposure, embedding=corrected)

    def close(self) -> None:
        """Stop the sensor."""
        self._sensor.close()
