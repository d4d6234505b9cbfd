"""Masks that others use, each by the property it is known for."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.unit.optics.tensors import seeded

from veilcam_optics.apertures import (
    diffuser_height,
    lay_cells,
    measured_psf,
    mls_cells,
    normalise_psf,
    phase_plate,
    read_image,
    remove_background,
)
from veilcam_optics.errors import OpticsError
from veilcam_optics.propagation.psf import PointSpread
from veilcam_optics.propagation.sampling import Grid

WAVELENGTH = 550e-9


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


def test_cells_keep_their_area_on_any_grid() -> None:
    cells = mls_cells(4, repeats=1)
    for pitch in (3e-6, 7.7e-6, 40e-6):
        grid = Grid.square(401, 402, pitch)
        laid = lay_cells(cells, 30e-6, grid)
        assert float(laid.sum()) * pitch**2 == pytest.approx(float(cells.sum()) * (30e-6) ** 2)
    exact = lay_cells(cells, 30e-6, Grid.square(15, 15, 30e-6))
    assert torch.allclose(exact, cells)


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


def test_bad_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(OpticsError, match="cannot read the image text"):
        read_image(tmp_path / "text.png")
    with pytest.raises(OpticsError, match="cannot read the image gone"):
        read_image(tmp_path / "gone.png")


GRID = Grid.square(16, 16, 2e-6)


@pytest.mark.parametrize(
    ("attempt", "message"),
    [
        (lambda: normalise_psf(torch.zeros(4, 4)), "no light"),
        (lambda: remove_background(torch.full((4, 4), math.nan)), "NaN"),
        (lambda: remove_background(torch.zeros(4, 4), margin=0.7), "margin"),
        (lambda: remove_background(torch.zeros(4, 4), deviations=-1), "deviations"),
        (lambda: mls_cells(17), "order"),
        (lambda: lay_cells(torch.ones(2, 2), 0.0, GRID), "feature"),
        (
            lambda: diffuser_height(GRID, roughness=1e-6, correlation=1e-6, generator=seeded()),
            "correlation",
        ),
        (lambda: phase_plate(torch.zeros(2, 2), WAVELENGTH, index=0.9), "index"),
        (
            lambda: PointSpread(
                GRID, GRID, wavelength=WAVELENGTH, distance=1e-3, point=(1e-3, 0.0)
            ),
            "point",
        ),
    ],
)
def test_dark_pictures_and_impossible_masks_are_refused(
    attempt: Callable[[], object], message: str
) -> None:
    with pytest.raises(OpticsError, match=message):
        attempt()
