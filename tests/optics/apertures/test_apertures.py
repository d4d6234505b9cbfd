"""Masks that others use, each by the property it is known for."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from veilcam_optics.apertures import (
    contour_pattern,
    diffuser_height,
    fresnel_zones,
    lay_cells,
    lens,
    measured_psf,
    mls_cells,
    mura_cells,
    mura_decoder,
    normalise_psf,
    phase_for_pattern,
    phase_plate,
    pinhole,
    read_image,
    remove_background,
)
from veilcam_optics.errors import OpticsError
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.psf import PointSpread
from veilcam_optics.propagation.sampling import Grid

WAVELENGTH = 550e-9


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def correlate(a: Tensor, b: Tensor) -> Tensor:
    """Periodic correlation."""
    spectrum = torch.fft.fft2(a).conj() * torch.fft.fft2(b)
    return torch.as_tensor(torch.fft.ifft2(spectrum).real)


@pytest.mark.parametrize("order", [2, 5, 6])
def test_mls_correlates_to_a_single_peak(order: int) -> None:
    cells = mls_cells(order, repeats=1)
    length = 2**order - 1
    assert cells.shape == (length, length)
    signs = 2 * cells - 1
    line = signs[0] * signs[0, 0]
    peak = torch.fft.ifft(torch.fft.fft(line).abs().square()).real
    assert float(peak[0]) == pytest.approx(length)
    assert torch.allclose(peak[1:], torch.full((length - 1,), -1.0, dtype=torch.float64))
    # Separable: of rank one as signs.
    assert int(torch.linalg.matrix_rank(signs)) == 1
    assert mls_cells(order, repeats=2).shape == (2 * length, 2 * length)


@pytest.mark.parametrize("side", [5, 11, 31])
def test_mura_decodes_to_a_single_peak(side: int) -> None:
    cells = mura_cells(side)
    assert float(cells.sum()) == (side**2 - 1) / 2
    peak = correlate(cells, mura_decoder(side))
    assert float(peak[0, 0]) == pytest.approx((side**2 - 1) / 2)
    peak[0, 0] = 0
    assert float(peak.abs().max()) < 1e-9


def test_cells_keep_their_area_on_any_grid() -> None:
    cells = mura_cells(11)
    for pitch in (3e-6, 7.7e-6, 40e-6):
        grid = Grid.square(401, 402, pitch)
        laid = lay_cells(cells, 30e-6, grid)
        assert float(laid.sum()) * pitch**2 == pytest.approx(float(cells.sum()) * (30e-6) ** 2)
    exact = lay_cells(cells, 30e-6, Grid.square(11, 11, 30e-6))
    assert torch.allclose(exact, cells)


def test_fresnel_zones_focus_as_a_zone_plate() -> None:
    """A zone plate of radius r focuses at r^2 / wavelength."""
    radius = 60e-6
    focal = radius**2 / WAVELENGTH
    grid = Grid.square(200, 200, 2e-6)
    zones = fresnel_zones(grid, radius)
    assert float(zones[99:101, 99:101].mean()) == pytest.approx(1, abs=1e-3)
    spread = PointSpread(grid, grid, wavelength=WAVELENGTH, distance=focal)
    spot = spread(zones)
    open_spot = spread(torch.ones(grid.shape, dtype=torch.float64))
    assert float(spot[99:101, 99:101].mean()) > 5 * float(open_spot[99:101, 99:101].mean())
    assert torch.equal(fresnel_zones(grid, radius, binary=True), (zones >= 0.5).double())
    assert float(fresnel_zones(grid, radius, phase=math.pi)[100, 100]) < 1e-2


def test_pinhole_area() -> None:
    grid = Grid.square(41, 40, 2e-6)
    hole = pinhole(grid, 25e-6, parts=16)
    assert float(hole.sum()) * 4e-12 == pytest.approx(math.pi * (25e-6) ** 2, rel=2e-3)
    coarse = pinhole(grid, 25e-6, parts=1)
    assert set(coarse.flatten().tolist()) == {0.0, 1.0}


def test_lens_images_a_point_to_a_point() -> None:
    """An object at 2 f appears at 2 f, of the size of the Airy disc and no larger."""
    focal, diameter = 5e-3, 0.4e-3
    grid = Grid.square(240, 241, 2e-6)
    target = Grid.square(81, 81, 2e-6)
    thin = lens(grid, focal, WAVELENGTH, diameter=diameter)
    spot = PointSpread(
        grid, target, wavelength=WAVELENGTH, scene_distance=2 * focal, distance=2 * focal
    )(thin)
    airy = 1.22 * WAVELENGTH * 2 * focal / diameter
    y, x = target.y()[:, None], target.x()
    inside = float(spot[(y**2 + x**2) <= airy**2].sum())
    # 83.8 % of the light lies inside the first dark ring (Born and Wolf 8.5.2).
    arrived = float(thin.abs().square().sum()) * 4e-12
    assert inside * 4e-12 / arrived == pytest.approx(0.838, abs=0.01)
    out_of_focus = PointSpread(
        grid, target, wavelength=WAVELENGTH, scene_distance=2 * focal, distance=1.5 * focal
    )(thin)
    assert float(out_of_focus.max()) < 0.3 * float(spot.max())


def test_lens_moves_the_image_of_a_point_off_axis_the_other_way() -> None:
    focal = 5e-3
    grid, target = Grid.square(240, 240, 2e-6), Grid.square(121, 121, 2e-6)
    thin = lens(grid, focal, WAVELENGTH, diameter=0.4e-3)
    spot = PointSpread(
        grid,
        target,
        wavelength=WAVELENGTH,
        scene_distance=2 * focal,
        distance=2 * focal,
        point=(40e-6, -60e-6),
    )(thin)
    row, column = divmod(int(spot.argmax()), 121)
    assert float(target.y()[row]) == pytest.approx(-40e-6)
    assert float(target.x()[column]) == pytest.approx(60e-6)


def test_diffuser_has_the_roughness_and_correlation_asked_for() -> None:
    grid = Grid.square(512, 512, 2e-6)
    height = diffuser_height(grid, roughness=0.4e-6, correlation=20e-6, generator=seeded())
    assert float(height.std()) == pytest.approx(0.4e-6, rel=1e-3)
    at_correlation = float((height[:, :-10] * height[:, 10:]).mean() / height.square().mean())
    assert at_correlation == pytest.approx(math.exp(-1), abs=0.05)
    again = diffuser_height(grid, roughness=0.4e-6, correlation=20e-6, generator=seeded())
    assert torch.equal(height, again)
    plate = phase_plate(height, WAVELENGTH)
    assert torch.allclose(plate.abs(), torch.ones_like(height))
    wanted = 2 * math.pi * 0.5 / WAVELENGTH * float(height[3, 5])
    assert float(plate[3, 5].angle()) == pytest.approx(math.remainder(wanted, 2 * math.pi))
    denser = phase_plate(height, WAVELENGTH, index=1.6)
    assert not torch.allclose(denser, plate)


def test_contour_mask_makes_its_pattern() -> None:
    grid = Grid.square(192, 192, 4e-6)
    pattern = contour_pattern(grid, spacing=120e-6, width=16e-6, generator=seeded())
    assert float(pattern.mean()) == pytest.approx(1)
    assert float((pattern > 1).double().mean()) < 0.3  # lines, not areas
    correlations = []
    for iterations in (1, 40):
        phase = phase_for_pattern(
            pattern,
            grid,
            distance=2e-3,
            wavelength=WAVELENGTH,
            iterations=iterations,
            generator=seeded(),
        )
        run = AngularSpectrum(padding="none").prepare(grid, grid, 2e-3, WAVELENGTH)
        got = run(torch.exp(1j * phase)).abs().square()
        both = torch.stack([got.flatten(), pattern.flatten()])
        correlations.append(float(torch.corrcoef(both)[0, 1]))
    assert correlations[1] > max(0.8, correlations[0])


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """A 16 bit frame: a bright blob on a background of 1000 with noise."""
    y, x = np.mgrid[:120, :160]
    blob = 30000 * np.exp(-((y - 60) ** 2 + (x - 80) ** 2) / 50.0)
    noise = np.random.default_rng(0).normal(1000, 30, blob.shape)
    path = tmp_path / "psf.png"
    Image.fromarray((blob + noise).astype(np.uint16)).save(path)
    return path


def test_measured_psf_has_its_background_removed(picture: Path) -> None:
    raw = read_image(picture)
    assert raw.shape == (120, 160)
    assert float(raw.max()) == pytest.approx(31000 / 65535, rel=0.01)
    psf = measured_psf(picture)
    assert float(psf.sum()) == pytest.approx(1)
    blob = 30000 * 50 * math.pi
    removed = remove_background(raw) * 65535
    assert float(removed.sum()) == pytest.approx(blob, rel=0.02)
    assert float((removed[:30] > 0).double().mean()) < 5e-3
    # What the background would do: as much light as the blob has, all over the sensor.
    assert float(raw.sum() * 65535) > 4 * blob
    assert float((remove_background(raw, deviations=0) > 0).double().mean()) > 0.4
    wide = remove_background(raw, margin=0.2)
    assert not torch.equal(wide, remove_background(raw))


def test_colour_pictures_keep_their_channels_apart(tmp_path: Path) -> None:
    values = np.zeros((20, 30, 3), dtype=np.uint8)
    values[10, 15] = (200, 100, 50)
    Image.fromarray(values).save(tmp_path / "rgb.png")
    psf = measured_psf(tmp_path / "rgb.png")
    assert psf.shape == (3, 20, 30)
    assert psf[:, 10, 15].tolist() == pytest.approx([12 / 7, 6 / 7, 3 / 7])
    assert float(psf.sum()) == pytest.approx(3)


def test_bad_files_and_dark_pictures_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(OpticsError, match="cannot read the image text"):
        read_image(tmp_path / "text.png")
    with pytest.raises(OpticsError, match="cannot read the image gone"):
        read_image(tmp_path / "gone.png")
    with pytest.raises(OpticsError, match="no light"):
        normalise_psf(torch.zeros(4, 4))
    with pytest.raises(OpticsError, match="NaN"):
        remove_background(torch.full((4, 4), math.nan))
    with pytest.raises(OpticsError, match="margin"):
        remove_background(torch.zeros(4, 4), margin=0.7)
    with pytest.raises(OpticsError, match="deviations"):
        remove_background(torch.zeros(4, 4), deviations=-1)


def test_impossible_masks_are_refused() -> None:
    grid = Grid.square(16, 16, 2e-6)
    with pytest.raises(OpticsError, match="odd prime"):
        mura_cells(9)
    with pytest.raises(OpticsError, match="order"):
        mls_cells(17)
    with pytest.raises(OpticsError, match="feature"):
        lay_cells(torch.ones(2, 2), 0.0, grid)
    with pytest.raises(OpticsError, match="at least"):
        fresnel_zones(Grid.square(1000, 1000, 4e-6), 50e-6)
    with pytest.raises(OpticsError, match="radius"):
        pinhole(grid, 1e-9)
    with pytest.raises(OpticsError, match=r"grid\.pitch"):
        lens(Grid.square(500, 500, 4e-6), 1e-3, WAVELENGTH, diameter=2e-3)
    with pytest.raises(OpticsError, match="correlation"):
        diffuser_height(grid, roughness=1e-6, correlation=1e-6, generator=seeded())
    with pytest.raises(OpticsError, match="width"):
        contour_pattern(grid, spacing=1e-5, width=2e-5, generator=seeded())
    with pytest.raises(OpticsError, match="index"):
        phase_plate(torch.zeros(2, 2), WAVELENGTH, index=0.9)
    with pytest.raises(OpticsError, match=r"pattern\.shape"):
        phase_for_pattern(
            torch.ones(3, 3), grid, distance=1e-3, wavelength=WAVELENGTH, generator=seeded()
        )
    with pytest.raises(OpticsError, match="not all zero"):
        phase_for_pattern(
            torch.zeros(16, 16), grid, distance=1e-3, wavelength=WAVELENGTH, generator=seeded()
        )
    with pytest.raises(OpticsError, match="point"):
        PointSpread(grid, grid, wavelength=WAVELENGTH, distance=1e-3, point=(1e-3, 0.0))
