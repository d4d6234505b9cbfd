"""The cameras that a programmable mask is compared with: lens, coded aperture, diffuser."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from veilcam_optics.apertures import diffuser_height, lay_cells, mls_cells, phase_plate
from veilcam_optics.camera.geometry import Camera, Scene
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.psf import PointSpread
from veilcam_optics.propagation.sampling import Grid, covering_grid
from veilcam_training.encoders.psf import Psf

LENS_DISTANCE = 7.53e-3
"""Lens to sensor [m] (the paper, appendix A)."""
APERTURE_DISTANCE = 0.5e-3
"""Coded aperture to sensor [m] (the paper, appendix A)."""
APERTURE_FEATURE = 30e-6
"""Side of one opening of the coded aperture [m] (the paper, appendix A)."""
DIFFUSER_DISTANCE = 4e-3
"""Diffuser to sensor [m] (the paper, appendix A)."""
DIFFUSER_SLOPE = math.radians(0.7)
"""Root mean square angle by which the diffuser bends a ray, along each axis [rad]."""
DIFFUSER_CORRELATION = 120e-6
"""Correlation length of its surface [m].

Rays of a Gaussian surface meet at about correlation / (sqrt(6) slope): here after 4 mm, so that the
sensor sees the net of sharp caustics that such cameras are made for (Antipa et al. 2018).
"""

INDEX = 1.5
"""Refractive index of the diffuser."""


def lens_psf(camera: Camera) -> Psf:
    """Return the PSF of an ideal lens: a point is seen as a point, on one sensor pixel.

    Its strength is that of all light that falls on the sensor.
    """
    pixels = camera.sensor.rows * camera.sensor.columns
    irradiance = torch.full((3, 1, 1), float(pixels), dtype=torch.float64)
    return Psf(irradiance, camera.sensor.pixel, LENS_DISTANCE)


def coded_aperture_psf(camera: Camera, scene: Scene) -> Psf:
    """Return the PSF of the paper's coded aperture, a separable MLS pattern, with diffraction."""
    pitch = 2 * camera.sensor.pixel
    cells = mls_cells()
    side = len(cells) * APERTURE_FEATURE
    grid = covering_grid(side, side, pitch)
    # A grid cell that is open in part gets the root of its share: the light through it is exact.
    mask = lay_cells(cells, APERTURE_FEATURE, grid).sqrt()
    return _propagate(camera, scene, grid, lambda _: mask, APERTURE_DISTANCE)


def diffuser_psf(camera: Camera, scene: Scene, generator: torch.Generator) -> Psf:
    """Return the PSF of a smooth random relief as large as the sensor, thin, without dispersion."""
    grid = covering_grid(camera.sensor.height, camera.sensor.width, 3 * camera.sensor.pixel)
    # A Gaussian relief has a root mean square slope of sqrt(2) roughness / correlation, and bends
    # light by (index - 1) times it.
    roughness = DIFFUSER_SLOPE * DIFFUSER_CORRELATION / (math.sqrt(2) * (INDEX - 1))
    height = diffuser_height(
        grid, roughness=roughness, correlation=DIFFUSER_CORRELATION, generator=generator
    )
    return _propagate(
        camera,
        scene,
        grid,
        lambda wavelength: phase_plate(height, wavelength, index=INDEX),
        DIFFUSER_DISTANCE,
    )


def _propagate(
    camera: Camera,
    scene: Scene,
    grid: Grid,
    transmittance: Callable[[float], Tensor],
    distance: float,
) -> Psf:
    """PSF on the sensor and as far beyond it as the scene's image shifts it."""
    pitch = float(grid.pitch_y)
    image = scene.height * distance / scene.distance
    width = image * scene.columns / scene.rows
    target = covering_grid(camera.sensor.height + image, camera.sensor.width + width, pitch)
    psfs = [
        PointSpread(
            grid,
            target,
            wavelength=wavelength,
            distance=distance,
            scene_distance=scene.distance,
            propagator=AngularSpectrum(padding="reach"),
            dtype=torch.complex64,
        )(transmittance(wavelength))
        for wavelength in camera.wavelengths
    ]
    return Psf(torch.stack(psfs), pitch, distance)
