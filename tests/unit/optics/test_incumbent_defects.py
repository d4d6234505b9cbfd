"""Defects found in other optics packages, each as a test that this one does not have it."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from tests.unit.optics.tensors import mask
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Sensor, Window
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.psf import PointSpread
from veilcam_optics.propagation.sampling import Grid, area_average
from veilcam_optics.transfer.grid import GridLight

CAMERA = Camera(
    window=Window(12, 5, 180, 74), sensor=Sensor(760, 1016, pixel=1.55e-6), distance=4e-3
)
SCENE, EMBEDDING = Scene(6, 8, 0.06, 0.4), Embedding(5, 7)


def centroid(values: Tensor, grid: Grid) -> tuple[float, float]:
    total = values.sum()
    y = (values.sum(1) * grid.y()).sum() / total
    x = (values.sum(0) * grid.x()).sum() / total
    return float(y), float(x)


@pytest.mark.parametrize("shape", [(64, 64), (63, 64), (64, 63), (63, 63)])
@pytest.mark.parametrize("target_shape", [(80, 80), (81, 80), (81, 81)])
def test_odd_sizes_are_not_shifted_by_a_pixel(
    shape: tuple[int, int], target_shape: tuple[int, int]
) -> None:
    source, target = Grid.square(*shape, 4e-6), Grid.square(*target_shape, 4e-6)
    beam = torch.exp(-(source.y().square()[:, None] + source.x().square()) / (30e-6) ** 2)
    spread = PointSpread(source, target, wavelength=550e-9, distance=1e-3)
    y, x = centroid(spread(beam), target)
    assert abs(y) < 1e-4 * 4e-6
    assert abs(x) < 1e-4 * 4e-6


def test_each_colour_is_propagated_at_its_own_wavelength() -> None:
    """R drawn and 460 nm propagated: the wider diffraction of red would be blue's."""
    panel = dataclasses.replace(CAMERA.panel, filter_cycle=())
    camera = dataclasses.replace(CAMERA, panel=panel)
    light = GridLight(camera, SCENE, 2)
    psf = light.psf(mask(CAMERA))
    for channel, wavelength in enumerate(camera.wavelengths):
        alone = dataclasses.replace(camera, wavelengths=(wavelength,) * 3)
        same = GridLight(alone, SCENE, 2).psf(mask(CAMERA))
        assert torch.allclose(psf[channel], same[0], rtol=1e-10)
    assert camera.wavelengths[0] > camera.wavelengths[1] > camera.wavelengths[2]


@pytest.mark.parametrize("oversampling", [1.0, 1.37, 2.0, 3.3, 4.0])
def test_open_area_is_not_floored(oversampling: float) -> None:
    """Whole samples only would leave 0.77 of the open area."""
    light = GridLight(CAMERA, SCENE, oversampling)
    shown = light.mask(torch.ones(CAMERA.mask_shape, dtype=torch.float64), 1)
    power = float(shown.square().sum()) * float(light.mask_grid.pitch_y) ** 2
    panel = CAMERA.panel
    rows = sum(amplitude > 0 for amplitude in CAMERA.row_amplitudes(1))
    assert power == pytest.approx(rows * 5 * panel.aperture_y * panel.aperture_x, rel=1e-9)


def test_weights_at_the_ends_do_not_die() -> None:
    light = GridLight(CAMERA, SCENE, 1)
    edge = torch.ones(CAMERA.mask_shape, dtype=torch.float64)
    edge.requires_grad_()
    torch.autograd.backward(light.psf(edge).sum())
    assert edge.grad is not None
    assert bool((edge.grad != 0).all())


def test_every_option_of_the_angular_spectrum_does_something() -> None:
    grid = Grid.square(64, 64, 4e-6)
    field = torch.ones(64, 64, dtype=torch.complex128)
    base = AngularSpectrum().prepare(grid, grid, 20e-3, 550e-9)(field)
    for changed in (
        AngularSpectrum(padding="none"),
        AngularSpectrum(guard=0.0),
        AngularSpectrum(band_limit=False),
    ):
        other = changed.prepare(grid, grid, 20e-3, 550e-9)(field)
        assert float((other - base).norm() / base.norm()) > 1e-4, changed
    near = AngularSpectrum().prepare(grid, grid, 1e-4, 550e-9)(field)
    reach = AngularSpectrum(padding="reach").prepare(grid, grid, 1e-4, 550e-9)(field)
    assert float((near - reach).norm()) > 0


def test_binning_reads_every_pixel() -> None:
    """Bilinear resizing without antialiasing would miss a bright pixel between its samples."""
    image = torch.zeros(380, 507, dtype=torch.float64)
    for row, column in ((0, 0), (7, 3), (200, 250), (379, 506)):
        image.zero_()
        image[row, column] = 1
        binned = area_average(image, 24, 32)
        assert float(binned.sum()) * (380 * 507) / (24 * 32) == pytest.approx(1)
