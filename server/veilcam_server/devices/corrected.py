"""A sensor whose measurements are those that decoders expect."""

from __future__ import annotations

from dataclasses import replace
from typing import Self

import numpy as np

from veilcam_client.numbers import erasable
from veilcam_client.wire.calibration import CalibrationRecord, SignedCalibration
from veilcam_server.devices.base import Device, Exposure, Light, Measurement, Sensor


def calibrated(device: Device, signed: SignedCalibration | None) -> Device:
    """Return the device with measurements as decoders expect them."""
    if signed is None:
        return device
    return replace(device, sensor=CalibratedSensor.of(device.sensor, signed.record))


class CalibratedSensor:
    """Takes black level and stray light off, and the gain out of every measurement.

    Stray light falls evenly on the sensor: a share ``s`` makes ``(1 - s) y + s mean(y)`` of a
    measurement ``y``. The mean stays what it was, so ``y`` can be had back.

    Args:
        sensor: closed with this.
        black_level: measurement without light.
        gain: measurement where a decoder expects 1.
        stray_light: share of the light that is spread evenly, in [0, 1).
    """

    def __init__(
        self, sensor: Sensor, *, black_level: float, gain: float, stray_light: float
    ) -> None:
        self._sensor, self._black_level, self._gain = sensor, black_level, gain
        self._stray_light = stray_light
        self.name = sensor.name
        self.full_scale = (sensor.full_scale - black_level) / gain
        """Measurement of saturated pixels."""

    @classmethod
    def of(cls, sensor: Sensor, record: CalibrationRecord) -> Self:
        """Return ``sensor`` as it was measured."""
        return cls(
            sensor,
            black_level=record.black_level.value,
            gain=record.gain.value,
            stray_light=record.stray_light.value,
        )

    def capture(self, not_before: float, timeout: float) -> Exposure:
        """As the sensor does."""
        exposure = self._sensor.capture(not_before, timeout)
        return replace(exposure, embedding=self.corrected(exposure.embedding))

    def light(self, not_before: float, timeout: float) -> Light:
        """As the sensor does."""
        return self._sensor.light(not_before, timeout)

    def corrected(self, measurement: Measurement) -> Measurement:
        """Return what a decoder expects for a measurement of the sensor."""
        light = erasable(measurement, np.float64)
        light -= self._black_level
        light /= self._gain
        light -= self._stray_light * light.mean()
        light /= 1 - self._stray_light
        return erasable(light)

    def close(self) -> None:
        """Stop the sensor."""
        self._sensor.close()
