"""What a decoder expects of the noise in a measurement."""

import math
from dataclasses import dataclass

from torch import Tensor

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

    def variance(self, mean: Tensor, spread: Tensor) -> Tensor:
        """Expected variance of the noise in each pixel of a measurement.

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
        mean = mean.clamp_min(0)
        energy = (mean.square() + spread).sum()
        total = mean.sum()
        if not bool((energy > 0) & (total > 0)):
            return mean.new_ones(mean.shape)
        shot = mean * (energy / total) * 10 ** (-self.snr_db / 10)
        model = (mean.square() + spread) * self.model_error**2
        floor = 1e-6 * energy / len(mean) * 10 ** (-self.snr_db / 10)
        return shot + model + floor


DEFAULT_NOISE = MeasurementNoise()
"""40 dB, as the paper assumes, and a geometry that is known exactly."""
