"""The grid path from mask to embedding: general, and independent of the factored path.

Sub-pixel weights become a field on a grid, the field is propagated to the sensor, its irradiance is
the point spread function (PSF), and the embedding is the scene's geometric image, blurred by the
PSF and averaged over embedding pixels (the paper's Algorithm 1 with exact areas).
"""

from typing import Protocol

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import CHANNELS, Camera, Embedding, Scene
from veilcam_optics.camera.inputs import check_scenes, check_weights
from veilcam_optics.errors import require, require_memory, require_positive, require_shape
from veilcam_optics.propagation import AngularSpectrum, Propagator
from veilcam_optics.propagation.base import TURN, complex_type, unit_phasor
from veilcam_optics.propagation.psf import PointSpread
from veilcam_optics.propagation.sampling import (
    Grid,
    as_float,
    axis,
    coverage,
    covering_grid,
    fast_length,
)

SENSOR_PIXELS_PER_SAMPLE = 8
"""Sensor pixels per grid sample at oversampling 1: the paper's simulation grid."""

FEWEST_CELLS = 2.4
"""Across an aperture. The ST7735R has so many at oversampling 1/2, and is 6 % off there."""

_SCENES_AT_ONCE = 8
_PADDED_BY_REACH = AngularSpectrum(padding="reach")


def sample_pitch(camera: Camera, oversampling: float = 1) -> float:
    """Side of a sample, ``oversampling`` of which are as long as 8 sensor pixels [m]."""
    return SENSOR_PIXELS_PER_SAMPLE * camera.sensor.pixel / oversampling


def cells_in_aperture(camera: Camera, oversampling: float = 1) -> float:
    """Return the number of samples across the narrower side of a sub-pixel's aperture."""
    panel = camera.panel
    return min(panel.aperture_y, panel.aperture_x) / sample_pitch(camera, oversampling)


def check_oversampling(camera: Camera, oversampling: float) -> None:
    """Raise :class:`OpticsError` unless samples are fine enough for the panel's apertures.

    Cells that apertures cut misplace light: with two cells in an aperture of 6.6 um, 1 mm before
    the sensor, the transfer is 30 % off.
    """
    require_positive("oversampling", oversampling, "samples per 8 sensor pixels")
    least = FEWEST_CELLS / cells_in_aperture(camera)
    require(
        oversampling >= least,
        "oversampling",
        oversampling,
        "samples per 8 sensor pixels",
        f"at least {least:.3g}, for {FEWEST_CELLS:g} samples across an aperture",
    )


class MaskOnGrid(Protocol):
    """Mask on a grid: amplitudes of cells from those of sub-pixels."""

    grid: Grid

    def __call__(self, weights: Tensor) -> Tensor:
        """Amplitudes on ``grid`` of amplitudes of ``camera.mask_shape``; linear."""


class SampledMask:
    """A mask in its place as amplitudes on a grid, dead space included.

    A cell covered in part gets the root of its share as amplitude, so that the power through it is
    exact. The share itself would lose power at every edge: 4 % of the ST7735R's at oversampling 2,
    ten times what is left of the error this way.

    Args:
        camera: panel and window.
        grid: cells of the mask; see :func:`mask_grid` for the smallest.
        dtype: type of the amplitudes.
        device: device of all tensors.
    """

    def __init__(
        self, camera: Camera, grid: Grid, dtype: torch.dtype, device: torch.device | None = None
    ) -> None:
        self.grid = grid
        self._rows, self._columns = (
            _apertures(centres, width, cells, as_float(pitch)).to(device=device, dtype=dtype)
            for centres, width, cells, pitch in (
                (camera.row_centres, camera.panel.aperture_y, grid.rows, grid.pitch_y),
                (camera.column_centres, camera.panel.aperture_x, grid.columns, grid.pitch_x),
            )
        )

    def __call__(self, weights: Tensor) -> Tensor:
        """Amplitudes on ``grid``; differentiable."""
        return self._rows @ weights @ self._columns.mT


def mask_grid(camera: Camera, pitch: float) -> Grid:
    """Return the smallest grid of cells of side ``pitch`` [m] that holds the mask."""
    window, panel = camera.window, camera.panel
    return covering_grid(
        (window.rows - 1) * panel.pitch_y + panel.aperture_y,
        (window.columns - 1) * panel.pitch_x + panel.aperture_x,
        pitch,
    )


class GridLight:
    """Light through one camera from one scene, on a grid.

    Attributes:
        grid: places of the PSF's samples; they cover the sensor plus the scene's geometric image.
        spreads: operators that turn a transmittance on ``mask_grid`` into its PSF, one per channel.
    """

    def __init__(
        self,
        camera: Camera,
        scene: Scene,
        oversampling: float = 2,
        dtype: torch.dtype = torch.float64,
        device: torch.device | None = None,
        *,
        grid: Grid | None = None,
        mask: MaskOnGrid | None = None,
        propagator: Propagator = _PADDED_BY_REACH,
    ) -> None:
        """Prepare everything that does not depend on the mask.

        Args:
            camera: Panel, window, sensor and their distance.
            scene: Size and distance of the object.
            oversampling: Grid samples per 8 sensor pixels; 2 is within 0.5 % at the embedding.
            dtype: torch.float32 or torch.float64, of weights, PSF and embeddings.
            device: device of all tensors.
            grid: places of the PSF's samples, in square cells; None for those of ``oversampling``.
            mask: mask on its grid; None for the panel in its place.
            propagator: propagator between mask and sensor.

        Raises:
            OpticsError: If ``oversampling`` is too coarse for the apertures, samples do not fit
                in memory, or ``dtype`` is no real float type.
        """
        if mask is None and grid is None:
            check_oversampling(camera, oversampling)
        require_positive("oversampling", oversampling, "samples per 8 sensor pixels")
        self.camera, self.scene, self.dtype = camera, scene, dtype
        self.device = device or torch.device("cpu")
        self.grid = grid or _sensor_grid(camera, scene, sample_pitch(camera, oversampling))
        require_memory(
            "oversampling",
            oversampling,
            "samples per 8 sensor pixels",
            float(self.grid.rows) * self.grid.columns,
            "fewer, a nearer sensor or a smaller scene",
        )
        self._mask = mask or SampledMask(
            camera, mask_grid(camera, as_float(self.grid.pitch_y)), dtype, self.device
        )
        self.spreads = tuple(
            PointSpread(
                self.mask_grid,
                self.grid,
                wavelength=wavelength,
                distance=camera.distance,
                scene_distance=scene.distance,
                propagator=propagator,
                dtype=complex_type(dtype),
                device=self.device,
            )
            for wavelength in camera.wavelengths
        )

    @property
    def mask_grid(self) -> Grid:
        """Grid on which the field right behind the mask is sampled."""
        return self._mask.grid

    def mask(self, weights: Tensor, channel: int) -> Tensor:
        """Return the transmittance that ``channel`` sees on ``mask_grid``, dead space included.

        Args:
            weights: Amplitude transmittance of every sub-pixel in [0, 1], shape of the mask.
            channel: 0 (R), 1 (G) or 2 (B); rows whose filter is
                another colour pass only its leakage.

        Raises:
            OpticsError: If the weights have the wrong shape, are NaN, or leave [0, 1].
        """
        return self._filtered(self._checked(weights), channel)

    def psf(self, weights: Tensor) -> Tensor:
        """Return the irradiance at the sensor from an on-axis scene point, one per channel.

        Args:
            weights: Amplitude transmittance of every sub-pixel in [0, 1], shape of the mask.

        Returns:
            Shape (3, rows, columns) on ``grid``, relative to the irradiance at the mask;
            differentiable in ``weights``.

        Raises:
            OpticsError: If the weights have the wrong shape, are NaN, or leave [0, 1].
        """
        return self.psf_of_amplitudes(self._checked(weights))

    def psf_of_amplitudes(self, amplitudes: Tensor) -> Tensor:
        """As :meth:`psf`, of what a panel shows: finite, but not held to [0, 1]."""
        return torch.stack(
            [spread(self._filtered(amplitudes, c)) for c, spread in enumerate(self.spreads)]
        )

    def gray_psf_of_amplitudes(self, amplitudes: Tensor) -> Tensor:
        """Return the gray form of :meth:`psf_of_amplitudes`, (rows, columns) on ``grid``."""
        gray = torch.zeros(self.grid.shape, dtype=self.dtype, device=self.device)
        for channel, (share, spread) in enumerate(
            zip(self.camera.sensor.channel_weights, self.spreads, strict=True)
        ):
            gray = gray + share * spread(self._filtered(amplitudes, channel))
        return gray

    def embed(self, scenes: Tensor, psf: Tensor, embedding: Embedding) -> Tensor:
        """Return the gray embeddings of gray scenes.

        Args:
            scenes: Reflectance in [0, 1], shape (..., rows, columns) of the scene.
            psf: result of :meth:`psf`.
            embedding: The grid to which the whole sensor is averaged.

        Returns:
            Shape (..., rows, columns) of the embedding: irradiance relative to what an all-white
            scene would give without mask and panel. Differentiable in ``scenes`` and ``psf``.

        Raises:
            OpticsError: If a shape does not match the scene or the grid.
        """
        self._check_psf(psf)
        shares = torch.tensor(self.camera.sensor.channel_weights, dtype=self.dtype)
        return self.embed_gray(
            scenes, torch.einsum("c,cyx->yx", shares.to(self.device), psf), embedding
        )

    def embed_colour(self, scenes: Tensor, psf: Tensor, embedding: Embedding) -> Tensor:
        """As :meth:`embed`, from colour to colour, both of shape (..., 3, rows, columns)."""
        self._check_psf(psf)
        check_scenes(scenes, ..., len(CHANNELS), *self.scene.shape)
        channels = [
            self.embed_gray(scenes[..., channel, :, :], psf[channel], embedding)
            for channel in range(len(CHANNELS))
        ]
        return torch.stack(channels, dim=-3)

    def embed_gray(self, scenes: Tensor, psf: Tensor, embedding: Embedding) -> Tensor:
        """As :meth:`embed`, of what :meth:`gray_psf_of_amplitudes` returned.

        That is (PSF * scene pixel box * embedding pixel box) at every offset that is needed. All
        of it happens in the frequency domain: the PSF is a Fourier series on the padded grid, a
        box is a sinc and an offset a phase, so that no fraction of a sample is ever rounded.
        """
        check_scenes(scenes, ..., *self.scene.shape)
        require_shape("psf", psf, *self.grid.shape)
        # Offsets reach no further than the grid, so the series need not be padded beyond it.
        lengths = tuple(fast_length(count) for count in self.grid.shape)
        spectrum = torch.fft.rfft2(psf, s=lengths) / (lengths[0] * lengths[1])
        # A real series is its zero frequency plus twice the real part of the positive half. The
        # Nyquist frequency of an even series has no sign, hence no shift: it is left out.
        keep_y, keep_x = (torch.full((n,), 1.0, dtype=self.dtype) for n in spectrum.shape)
        keep_x[1:] = 2
        if lengths[0] % 2 == 0:
            keep_y[lengths[0] // 2] = 0
        if lengths[1] % 2 == 0:
            keep_x[-1] = 0
        spectrum = spectrum * keep_y.to(self.device)[:, None] * keep_x.to(self.device)
        pitch = as_float(self.grid.pitch_y)
        fy = torch.fft.fftfreq(lengths[0], pitch, dtype=torch.float64, device=self.device)
        fx = torch.fft.rfftfreq(lengths[1], pitch, dtype=torch.float64, device=self.device)
        to_scene_y, from_pixel_y = self._boxes(fy, embedding, 0)
        to_scene_x, from_pixel_x = self._boxes(fx, embedding, 1)
        flat = scenes.to(device=self.device, dtype=self.dtype).reshape(-1, *self.scene.shape)
        results = []
        for first in range(0, len(flat), _SCENES_AT_ONCE):
            some = flat[first : first + _SCENES_AT_ONCE]
            image = to_scene_y @ some.to(to_scene_y.dtype) @ to_scene_x.mT
            results.append((from_pixel_y @ (image * spectrum) @ from_pixel_x.mT).real)
        if not results:
            return flat.new_zeros((*scenes.shape[:-2], *embedding.shape))
        return torch.cat(results).reshape(*scenes.shape[:-2], *embedding.shape)

    def _boxes(self, frequency: Tensor, embedding: Embedding, along: int) -> tuple[Tensor, Tensor]:
        """Return frequencies x scene pixels and embedding pixels x frequencies, for one axis."""
        box = embedding.box(self.camera.sensor)[along]
        scene_count, samples = self.scene.shape[along], self.grid.shape[along]
        complex_dtype = complex_type(self.dtype)
        side = self.scene.pixel_at_sensor(self.camera)
        # Inverted, as through a pinhole: the first scene pixel lands at the far end.
        image = -axis(scene_count, side, device=self.device)
        pixels = axis(embedding.shape[along], box / embedding.fill, device=self.device)
        first = -(samples - 1) / 2 * as_float(self.grid.pitch_y)
        ramp_in = unit_phasor(-TURN * frequency[:, None] * image, complex_dtype)
        ramp_out = unit_phasor(TURN * (pixels[:, None] - first) * frequency, complex_dtype)
        # Each box is divided by its own area but the scene's by the area of the whole scene.
        scene_box = (torch.sinc(frequency * side) / scene_count).to(self.dtype)
        pixel_box = torch.sinc(frequency * box).to(self.dtype)
        return ramp_in * scene_box[:, None], ramp_out * pixel_box

    def _filtered(self, amplitudes: Tensor, channel: int) -> Tensor:
        passed = torch.tensor(self.camera.row_amplitudes(channel), dtype=self.dtype)
        return self._mask(amplitudes * passed.to(self.device)[:, None])

    def _checked(self, weights: Tensor) -> Tensor:
        """Return the weights in this object's type."""
        check_weights(weights, self.camera)
        return weights.to(device=self.device, dtype=self.dtype)

    def _check_psf(self, psf: Tensor) -> None:
        require_shape("psf", psf, len(CHANNELS), *self.grid.shape)


def _sensor_grid(camera: Camera, scene: Scene, pitch: float) -> Grid:
    """Return a grid that covers the sensor plus the scene's geometric image."""
    height, width = camera.lit_sides(scene)
    # The margin holds the ripple at the edges of the Fourier series away from the sensor.
    margin = 8 * pitch
    return covering_grid(height + margin, width + margin, pitch)


def _apertures(centres: tuple[float, ...], width: float, samples: int, pitch: float) -> Tensor:
    """Return the amplitude of every grid cell behind each aperture, shape (samples, apertures)."""
    middle = torch.tensor(centres, dtype=torch.float64)
    shares = coverage(middle - width / 2, middle + width / 2, samples, pitch)
    # Apertures closer than a cell share one: its power is what all of them together let through.
    return (shares / shares.sum(0).clamp(min=1e-12).sqrt()).mT
