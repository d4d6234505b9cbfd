"""Noise that a decoder expects in a measurement."""

import math
from dataclasses import dataclass

from veilcam_optics.arrays import Array, namespace
from veilcam_optics.errors import require_within


@dataclass(frozen=True, slots=True)
class MeasurementNoise:
    """Shot noise at ``snr_db`` [dB], and an error of the transfer matrix that acts like noise.

    ``model_error`` is the relative rms error of the response (misalignment that calibration left,
    for example): an error of 1 % costs as much as noise at 40 dB.
    """

    snr_db: float = 40.0
    model_error: float = 0.0

    def __post_init__(self) -> None:
        require_within("noise.snr_db", self.snr_db, "dB", -math.inf, math.inf)
        require_within("noise.model_error", self.model_error, "", 0, math.inf)

    def variance(self, mean: Array, spread: Array) -> Array:
        """Return the expected variance of the noise in each pixel of a measurement.

        The variance of shot noise is proportional to the measurement, its share such that the
        energy of signal and noise have the ratio ``snr_db``
        (see :func:`veilcam_optics.sensor.noise.shot_noise`); measurement, energy and total are
        replaced by what the scene's statistics let one expect. A dark pixel keeps a trace of
        noise, so that nothing is divided by zero.

        Args:
            mean: expected measurement, (E,), not negative.
            spread: variance of the measurement over scenes, (E,).

        Returns:
            (E,), greater than zero. All ones if the mask lets no light through at all: then
            nothing is known, and decoding gives the mean scene.
        """
        xp = namespace(mean)
        mean = xp.clip(mean, 0, None)
        squares = mean * mean + spread
        energy, total = xp.sum(squares), xp.sum(mean)
        variance: Array
        if not bool((energy > 0) & (total > 0)):
            variance = xp.ones_like(mean)
            return variance
        ratio = 10 ** (-self.snr_db / 10)
        shot = mean * (energy / total) * ratio
        floor = 1e-6 * energy / mean.shape[0] * ratio
        variance = shot + squares * self.model_error**2 + floor
        return variance


DEFAULT_NOISE = MeasurementNoise()
"""40 dB, as the paper assumes, and a geometry that is known exactly."""
