"""The paper's Algorithm 1 as such, with its own sampling and resampling, to compare with.

E. Bezzam, M. Vetterli and M. Simeoni, "Privacy-Enhancing Optical Embeddings for Lensless
Classification" (2022): resize and pad the picture to the sensor's grid, convolve it with the PSF,
resize to the embedding, add shot noise. The two resizings are bilinear without antialiasing there:
pixels between the samples are not read. ``resampling="area"`` replaces both by area averages.
"""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.errors import OpticsError, require, require_choice, require_shape
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.base import TURN, unit_phasor
from veilcam_optics.propagation.sampling import Grid, area_average, fast_length, tiled
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.grid import SENSOR_PIXELS_PER_SAMPLE, GridLight, sample_pitch

Resampling = Literal["bilinear", "area"]


@dataclass(frozen=True, slots=True)
class Algorithm1:
    """Simulation of one camera and scene on the sensor's grid, an eighth of its resolution.

    Attributes:
        camera: Panel, window, sensor and their distance.
        scene: Size and distance of the object, and the shape of pictures of it.
        embedding: Shape of the result.
        resampling: ``"bilinear"``, the paper's, or ``"area"``.
        snr_db: Signal to noise ratio of the result [dB]; infinite for none.
    """

    camera: Camera
    scene: Scene
    embedding: Embedding
    resampling: Resampling = "bilinear"
    snr_db: float = 40.0

    def __post_init__(self) -> None:
        require_choice("resampling", self.resampling, ("bilinear", "area"))
        require(
            not math.isnan(self.snr_db),
            "snr_db",
            self.snr_db,
            "dB",
            "a number, or infinity for no noise",
        )
        rows, columns = self._object_samples()
        if rows > self.grid.rows or columns > self.grid.columns:
            image = self.scene.height * self.camera.distance / self.scene.distance
            raise OpticsError(
                f"the scene's image, {image:.3e} m tall, does not fit the sensor: use a smaller or "
                "more distant scene"
            )

    @property
    def grid(self) -> Grid:
        """The simulation grid: 380 x 507 samples of 12.4 um for the HQ camera."""
        sensor = self.camera.sensor
        return Grid.square(
            sensor.rows // SENSOR_PIXELS_PER_SAMPLE,
            sensor.columns // SENSOR_PIXELS_PER_SAMPLE,
            sample_pitch(self.camera),
        )

    def psf(self, weights: Tensor) -> Tensor:
        """Return the PSF (3, rows, columns) on ``grid`` of a mask of float64 or float32 weights.

        Raises:
            OpticsError: If the weights have the wrong shape, are NaN, or leave [0, 1].
        """
        light = GridLight(
            self.camera,
            self.scene,
            dtype=weights.dtype,
            grid=self.grid,
            propagator=AngularSpectrum(),
        )
        return light.psf(weights)

    def object_plane(self, pictures: Tensor) -> Tensor:
        """Return pictures (..., rows, columns) as the grid sees them: resized, centred, inverted.

        The paper leaves them upright; the camera inverts, and so does every other path here.
        """
        require_shape("pictures", pictures, ..., *self.scene.shape)
        inverted = pictures.flip(-2, -1)
        if self.resampling == "area":
            side, pitch = self.scene.pixel_at_sensor(self.camera), float(self.grid.pitch_y)
            rows, columns = (
                tiled(pixels, side, samples, pitch).to(pictures)
                for pixels, samples in zip(self.scene.shape, self.grid.shape, strict=True)
            )
            return rows.mT @ inverted @ columns
        rows_wanted, columns_wanted = self._object_samples()
        resized = _bilinear(inverted, rows_wanted, columns_wanted)
        top = (self.grid.rows - rows_wanted) // 2
        left = (self.grid.columns - columns_wanted) // 2
        bottom = self.grid.rows - rows_wanted - top
        right = self.grid.columns - columns_wanted - left
        return functional.pad(resized, (left, right, top, bottom))

    def __call__(
        self, pictures: Tensor, psf: Tensor, generator: torch.Generator | None = None
    ) -> Tensor:
        """Return the gray embeddings of gray pictures.

        Args:
            pictures: Shape (batch, rows, columns) of the scene, in [0, 1].
            psf: What :meth:`psf` returned.
            generator: Source of the noise.

        Returns:
            Shape (batch, rows, columns) of the embedding, in the same unit as every other path:
            relative to an all-white scene without mask and panel.

        Raises:
            OpticsError: If a shape does not match.
        """
        require_shape("psf", psf, 3, *self.grid.shape)
        if not pictures.numel():  # which the FFT refuses
            return pictures.new_zeros(*pictures.shape[:-2], *self.embedding.shape)
        shares = torch.tensor(
            self.camera.sensor.channel_weights, dtype=psf.dtype, device=psf.device
        )
        gray = (shares[:, None, None] * psf).sum(0)
        plane = self.object_plane(pictures)
        rows, columns = self.grid.shape
        # Linear convolution, cropped around the middle. The middle of an even size lies between two
        # samples: a ramp of phase shifts by halves, where an index would shift the picture.
        lengths = (fast_length(2 * rows - 1), fast_length(2 * columns - 1))
        fy = torch.fft.fftfreq(lengths[0], dtype=torch.float64, device=psf.device)
        fx = torch.fft.rfftfreq(lengths[1], dtype=torch.float64, device=psf.device)
        turns = fy[:, None] * ((rows - 1) / 2) + fx * ((columns - 1) / 2)
        spectrum = torch.fft.rfft2(plane, s=lengths) * torch.fft.rfft2(gray, s=lengths)
        spectrum = spectrum * unit_phasor(TURN * turns, spectrum.dtype)
        whole: Tensor = torch.fft.irfft2(spectrum, s=lengths)
        image = whole[..., :rows, :columns]
        side = self.scene.pixel_at_sensor(self.camera)
        samples = side**2 * self.scene.rows * self.scene.columns / float(self.grid.pitch_y) ** 2
        image = image / samples
        if self.resampling == "area":
            small = area_average(image, *self.embedding.shape)
        else:
            small = _bilinear(image, *self.embedding.shape)
        # The FFT leaves negative values of the size of its rounding where there is no light.
        return shot_noise(small.clamp(min=0), self.snr_db, generator)

    def _object_samples(self) -> tuple[int, int]:
        """Samples (rows, columns) that the scene's image covers."""
        side = self.scene.pixel_at_sensor(self.camera) / float(self.grid.pitch_y)
        return max(1, round(self.scene.rows * side)), max(1, round(self.scene.columns * side))


def _bilinear(values: Tensor, rows: int, columns: int) -> Tensor:
    """Resize (..., n, m) by interpolation between the four nearest samples alone."""
    flat = values.reshape(-1, 1, *values.shape[-2:])
    resized = functional.interpolate(flat, (rows, columns), mode="bilinear", align_corners=False)
    return resized.reshape(*values.shape[:-2], rows, columns)
