"""Defects found in other optics packages, each as a test that this one does not have it."""

from __future__ import annotations

import dataclasses
import inspect
import math

import pytest
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.errors import OpticsError
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.psf import PointSpread
from veilcam_optics.propagation.sampling import Grid, area_average
from veilcam_optics.propagation.spectral import Spectrum
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.grid import GridLight

CAMERA = Camera(
    window=Window(12, 5, 180, 74), sensor=Sensor(760, 1016, pixel=1.55e-6), distance=4e-3
)
SCENE, EMBEDDING = Scene(6, 8, 0.06, 0.4), Embedding(5, 7)


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def weights(camera: Camera = CAMERA) -> Tensor:
    return torch.rand(camera.mask_shape, generator=seeded(), dtype=torch.float64)


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
    psf = light.psf(weights())
    for channel, wavelength in enumerate(camera.wavelengths):
        alone = dataclasses.replace(camera, wavelengths=(wavelength,) * 3)
        same = GridLight(alone, SCENE, 2).psf(weights())
        assert torch.allclose(psf[channel], same[0], rtol=1e-10)
    assert camera.wavelengths[0] > camera.wavelengths[1] > camera.wavelengths[2]
    # And a filter for red passes rows of channel 0.
    filtered = GridLight(CAMERA, SCENE, 1)
    rows = torch.zeros(CAMERA.mask_shape, dtype=torch.float64)
    rows[0] = 1  # panel row 180, the first of a cycle: R
    powers = filtered.psf(rows).sum((1, 2))
    assert float(powers[0]) > 0
    assert float(powers[1:].sum()) == 0


@pytest.mark.parametrize("oversampling", [1.0, 1.5, 2.0, 3.3])
def test_open_area_is_not_floored(oversampling: float) -> None:
    """Whole samples only would leave 0.77 of the open area."""
    light = GridLight(CAMERA, SCENE, oversampling)
    mask = light.mask(torch.ones(CAMERA.mask_shape, dtype=torch.float64), 1)
    power = float(mask.square().sum()) * float(light.mask_grid.pitch_y) ** 2
    panel = CAMERA.panel
    rows = sum(amplitude > 0 for amplitude in CAMERA.row_amplitudes(1))
    assert power == pytest.approx(rows * 5 * panel.aperture_y * panel.aperture_x, rel=1e-9)


@pytest.mark.parametrize("level", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("snr_db", [10.0, 40.0])
def test_noise_asked_for_is_noise_delivered(level: float, snr_db: float) -> None:
    values = torch.rand(40, 24, 32, generator=seeded(), dtype=torch.float64) * level
    noise = shot_noise(values, snr_db, seeded(1)) - values
    delivered = 10 * math.log10(float(values.square().sum() / noise.square().sum()))
    assert delivered == pytest.approx(snr_db, abs=0.1)


def test_dim_mask_stays_dim() -> None:
    """A pattern divided by its own maximum would show the same light."""
    light = GridLight(CAMERA, SCENE, 1)
    mask = weights()
    assert torch.allclose(light.psf(mask / 2), light.psf(mask) / 4, rtol=1e-12)


def test_bright_neighbour_does_not_darken_a_picture() -> None:
    light = GridLight(CAMERA, SCENE, 1)
    psf = light.psf(weights())
    scenes = torch.rand(2, 6, 8, generator=seeded(), dtype=torch.float64)
    bright = scenes.clone()
    bright[1] = 1
    both, other = light.embed(scenes, psf, EMBEDDING), light.embed(bright, psf, EMBEDDING)
    assert torch.allclose(both[0], other[0], rtol=1e-12)


def test_weights_outside_the_range_are_refused_and_not_left_to_die() -> None:
    light = GridLight(CAMERA, SCENE, 1)
    for value in (-0.1, 1.1):
        mask = weights()
        mask[0, 0] = value
        with pytest.raises(OpticsError, match=r"outside \[0, 1\]"):
            light.psf(mask)
    edge = torch.ones(CAMERA.mask_shape, dtype=torch.float64)
    edge.requires_grad_()
    torch.autograd.backward(light.psf(edge).sum())
    assert edge.grad is not None
    assert bool((edge.grad != 0).all())


@pytest.mark.parametrize("kind", [AngularSpectrum, GridLight, PointSpread, Grid])
def test_misspelt_options_are_not_swallowed(kind: type) -> None:
    parameters = inspect.signature(kind).parameters.values()
    assert all(parameter.kind is not inspect.Parameter.VAR_KEYWORD for parameter in parameters)
    with pytest.raises(TypeError, match="wavelenght"):
        kind(wavelenght=1)


def test_every_option_of_the_angular_spectrum_does_something() -> None:
    """An absorbing boundary that absorbs nothing is an option that lies."""
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


@pytest.mark.parametrize("count", [8, 9, 15, 16])
def test_frequencies_are_those_of_the_dft(count: int) -> None:
    """linspace(-1/2p, 1/2p) is not: a plane wave of one bin must come out as one."""
    grid = Grid.square(1, count, 1e-6)
    spectrum = Spectrum(grid, grid, (1, count))
    for k in range(-(count // 2) + 1, (count + 1) // 2):
        wave = torch.exp(2j * torch.pi * k * torch.arange(count, dtype=torch.float64) / count)
        transformed = torch.fft.fft(wave.to(torch.complex128)).abs()
        assert float(spectrum.fx[int(transformed.argmax())]) == pytest.approx(k / (count * 1e-6))
    run = AngularSpectrum(padding="none", band_limit=False).prepare(grid, grid, 1e-4, 550e-9)
    k = 2
    wave = torch.exp(2j * torch.pi * k * torch.arange(count, dtype=torch.float64) / count)
    s = (550e-9 * k / (count * 1e-6)) ** 2
    phase = -2 * math.pi / 550e-9 * 1e-4 * s / (1 + math.sqrt(1 - s))
    wanted = wave.to(torch.complex128) * complex(math.cos(phase), math.sin(phase))
    assert torch.allclose(run(wave.to(torch.complex128)[None])[0], wanted, atol=1e-9)


def test_double_precision_meets_no_single_precision_kernel() -> None:
    """Linear to 1e-14 is not enough to tell; two distances that add up are."""
    grid = Grid.square(16, 16, 4e-6)
    field = torch.randn(16, 16, generator=seeded(), dtype=torch.complex128)
    method = AngularSpectrum()
    whole = method.prepare(grid, grid, 1e-3, 550e-9)(field)
    single = method.prepare(grid, grid, 1e-3, 550e-9, dtype=torch.complex64)(
        field.to(torch.complex64)
    )
    error = float((single.to(torch.complex128) - whole).norm() / whole.norm())
    assert whole.dtype == torch.complex128
    # A float32 kernel would make both equal; so they differ, by single precision and no more.
    assert 0 < error < 1e-6
    if isinstance(method, AngularSpectrum):
        periodic = AngularSpectrum(padding="none", band_limit=False)
        half = periodic.prepare(grid, grid, 5e-4, 550e-9)
        once = periodic.prepare(grid, grid, 1e-3, 550e-9)(field)
        assert float((half(half(field)) - once).norm() / once.norm()) < 1e-12


def test_gradient_at_the_evanescent_edge_is_a_number() -> None:
    """1 / (4 x 0.25 um) x 1 um is a sine of exactly 1."""
    wavelength = torch.tensor(1e-6, dtype=torch.float64, requires_grad=True)
    grid = Grid.square(4, 4, 0.25e-6)
    method = AngularSpectrum(padding="none", band_limit=False)
    field = torch.randn(4, 4, generator=seeded(), dtype=torch.complex128)
    arrived = method.prepare(grid, grid, 1e-6, wavelength)(field)
    (gradient,) = torch.autograd.grad(arrived.abs().square().sum(), wavelength)
    assert bool(torch.isfinite(gradient))
    assert bool(torch.isfinite(torch.view_as_real(arrived.detach())).all())


def test_binning_reads_every_pixel() -> None:
    """Bilinear resizing without antialiasing would miss a bright pixel between its samples."""
    image = torch.zeros(380, 507, dtype=torch.float64)
    for row, column in ((0, 0), (7, 3), (200, 250), (379, 506)):
        image.zero_()
        image[row, column] = 1
        binned = area_average(image, 24, 32)
        assert float(binned.sum()) * (380 * 507) / (24 * 32) == pytest.approx(1)


def test_zero_energy_has_a_stated_result() -> None:
    light = GridLight(CAMERA, SCENE, 1)
    closed = light.psf(torch.zeros(CAMERA.mask_shape, dtype=torch.float64))
    assert float(closed.abs().max()) == 0
    scenes = torch.zeros(2, 6, 8, dtype=torch.float64)
    assert float(light.embed(scenes, light.psf(weights()), EMBEDDING).abs().max()) == 0
    assert float(light.embed(scenes + 1, closed, EMBEDDING).abs().max()) == 0


@pytest.mark.parametrize("value", [-4e-3, 0.0, math.nan, math.inf])
def test_impossible_cameras_are_refused_with_unit_and_remedy(value: float) -> None:
    with pytest.raises(OpticsError, match=r"camera\.distance = .* m is not valid: use"):
        Camera(distance=value)
    with pytest.raises(OpticsError, match=r"aperture_y = .* m is not valid: use at most the pitch"):
        Panel(aperture_y=1e-3)
