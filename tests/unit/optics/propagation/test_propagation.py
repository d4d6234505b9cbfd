"""Contracts of the angular spectrum with each of its options."""

from __future__ import annotations

import math

import pytest
import torch
from benchmarks.accuracy.rayleigh_sommerfeld import RayleighSommerfeld
from tests.unit.optics.tensors import relative
from torch import Tensor

from veilcam_optics.errors import OpticsError
from veilcam_optics.propagation import AngularSpectrum, Propagator
from veilcam_optics.propagation.sampling import Grid

VARIANTS: tuple[Propagator, ...] = (
    AngularSpectrum(),
    AngularSpectrum(padding="reach"),
    AngularSpectrum(padding="none"),
    AngularSpectrum(band_limit=False),
)
WAVELENGTH, DISTANCE = 550e-9, 1e-3

every_method = pytest.mark.parametrize("method", VARIANTS, ids=repr)


def noise(*shape: int, seed: int = 0, dtype: torch.dtype = torch.complex128) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def smooth(grid: Grid, width: float, tilt: float = 0.0) -> Tensor:
    y, x = grid.y()[:, None], grid.x()
    return torch.exp(-(y**2 + (x - width / 3) ** 2) / width**2) * torch.exp(
        1j * tilt * (y + 0.5 * x)
    )


@every_method
def test_scaled_target_holds_the_same_field(method: Propagator) -> None:
    """Every third point of a grid of a third of the pitch is a point of the coarse grid."""
    source = Grid.square(9, 10, 5e-6)
    coarse, fine = Grid.square(5, 7, 6e-6), Grid.square(15, 21, 2e-6)
    wanted = method.prepare(source, coarse, DISTANCE, WAVELENGTH)(noise(9, 10))
    got = method.prepare(source, fine, DISTANCE, WAVELENGTH)(noise(9, 10))[1::3, 1::3]
    # The window that the band limit follows is rounded to fast lengths, which may differ.
    assert relative(got, wanted) < 2e-1


@every_method
def test_field_of_another_shape_or_type_is_refused(method: Propagator) -> None:
    grid = Grid.square(4, 4, 5e-6)
    run = method.prepare(grid, grid, DISTANCE, WAVELENGTH)
    with pytest.raises(OpticsError, match=r"field\.shape"):
        run(noise(4, 5))
    with pytest.raises(OpticsError, match=r"field\.dtype"):
        run(noise(4, 4).to(torch.complex64))
    for wavelength in (0.0, -5e-7, math.nan):
        with pytest.raises(OpticsError, match="wavelength"):
            method.prepare(grid, grid, DISTANCE, wavelength)
    with pytest.raises(OpticsError, match="dtype"):
        method.prepare(grid, grid, DISTANCE, WAVELENGTH, dtype=torch.float32)


@pytest.mark.thorough
@pytest.mark.parametrize("distance", [1e-4, 3e-4, 1e-3, 3e-3])
def test_field_agrees_with_the_direct_sum_where_it_is_supported(distance: float) -> None:
    source = Grid.square(32, 31, 2e-6)
    target = Grid(31, 30, 2e-6, 2e-6, centre_y=3.1e-6, centre_x=-4.7e-6)
    # The reference is sampled so finely that it is valid at every one of these distances.
    fine = Grid.square(32 * 5, 31 * 5, 2e-6 / 5)
    direct = RayleighSommerfeld().prepare(fine, target, distance, WAVELENGTH)
    wanted = direct(smooth(fine, 9e-6, tilt=2e4))
    method = AngularSpectrum(guard=2)
    assert method.supports(source, target, distance, WAVELENGTH)
    got = method.prepare(source, target, distance, WAVELENGTH)(smooth(source, 9e-6, tilt=2e4))
    assert relative(got, wanted) < 1e-2


@pytest.mark.parametrize("shape", [(64, 64), (63, 65), (1, 64)])
def test_there_and_back_again(shape: tuple[int, int]) -> None:
    grid = Grid.square(*shape, 4e-6)
    field = smooth(grid, 30e-6)
    if shape[0] == 1:
        field = field.abs().to(torch.complex128)
    there = AngularSpectrum(padding="none", band_limit=False).prepare(grid, grid, 2e-3, WAVELENGTH)
    back = AngularSpectrum(padding="none", band_limit=False).prepare(grid, grid, -2e-3, WAVELENGTH)
    assert relative(back(there(field)), field) < 1e-13
    wide = Grid.square(shape[0] + 96 if shape[0] > 1 else 1, shape[1] + 96, 4e-6)
    method = AngularSpectrum()
    out = method.prepare(grid, wide, 2e-3, WAVELENGTH)(field)
    returned = method.prepare(wide, grid, -2e-3, WAVELENGTH)(out)
    if shape[0] > 1:
        assert relative(returned, field) < 2e-3


def test_energy_is_conserved_exactly_when_periodic() -> None:
    grid = Grid.square(33, 40, 2e-6)
    field = noise(33, 40)
    run = AngularSpectrum(padding="none", band_limit=False).prepare(grid, grid, 5e-3, WAVELENGTH)
    assert float(run(field).norm() / field.norm()) == pytest.approx(1, abs=1e-13)


def test_evanescent_waves_decay_in_both_directions() -> None:
    grid = Grid.square(32, 32, 1e-7)  # samples finer than half a wavelength
    field = noise(32, 32)
    norms = []
    for distance in (-2e-6, -2e-7, 0.0, 2e-7, 2e-6):
        run = AngularSpectrum(padding="none").prepare(grid, grid, distance, WAVELENGTH)
        norms.append(float(run(field).norm()))
    assert norms[2] == pytest.approx(float(field.norm()), rel=1e-12)
    assert norms[0] < norms[1] < norms[2] > norms[3] > norms[4] > 0


@pytest.mark.parametrize("shape", [(40, 40), (41, 40), (41, 43)])
def test_shift_of_the_source_shifts_the_field(shape: tuple[int, int]) -> None:
    method = AngularSpectrum()
    grid = Grid.square(*shape, 4e-6)
    field = torch.zeros(shape, dtype=torch.complex128)
    field[10:20, 12:22] = noise(10, 10)
    run = method.prepare(grid, grid, 1.4e-3, WAVELENGTH)
    moved = run(field.roll((5, 3), (0, 1)))
    assert relative(moved[5:, 3:], run(field)[:-5, :-3]) < 1e-12
    # The same by moving the grids, by a length that is no multiple of the pitch.
    source = Grid(*shape, 4e-6, 4e-6, centre_y=1.23e-6, centre_x=-7e-6)
    target = Grid(*shape, 4e-6, 4e-6, centre_y=1.23e-6, centre_x=-7e-6)
    again = method.prepare(source, target, 1.4e-3, WAVELENGTH)(field)
    assert relative(again, run(field)) < 1e-9


def test_subpixel_shift_is_exact() -> None:
    """A Gaussian that is moved by a fraction of a sample equals a target moved the other way."""
    source = Grid.square(60, 61, 4e-6)
    target = Grid(50, 50, 4e-6, 4e-6, centre_y=1.3e-6, centre_x=2.9e-6)
    y, x = source.y()[:, None], source.x()

    def gaussian(at_y: float, at_x: float) -> Tensor:
        return torch.exp(-((y - at_y) ** 2 + (x - at_x) ** 2) / (30e-6) ** 2).to(torch.complex128)

    moved = AngularSpectrum().prepare(source, target, 1e-3, WAVELENGTH)(gaussian(1.3e-6, 2.9e-6))
    centred = Grid.square(50, 50, 4e-6)
    still = AngularSpectrum().prepare(source, centred, 1e-3, WAVELENGTH)(gaussian(0, 0))
    assert relative(moved, still) < 1e-5


def test_padding_changes_the_field_only_where_light_wraps_around() -> None:
    source = Grid.square(64, 64, 4e-6)
    field = torch.ones(64, 64, dtype=torch.complex128)
    full = AngularSpectrum().prepare(source, source, 1e-3, WAVELENGTH)(field)
    reach = AngularSpectrum(padding="reach").prepare(source, source, 1e-3, WAVELENGTH)(field)
    none = AngularSpectrum(padding="none").prepare(source, source, 1e-3, WAVELENGTH)(field)
    assert 0 < relative(reach, full) < 2e-2
    assert relative(none, full) > 5e-2


@pytest.mark.slow
def test_band_limit_keeps_a_far_field_clean() -> None:
    """A hard edge holds frequencies whose rays miss the window; they come back as noise."""
    source, distance = Grid.square(64, 64, 4e-6), 40e-3
    field = torch.zeros(64, 64, dtype=torch.complex128)
    field[20:44, 20:44] = 1
    exact = RayleighSommerfeld().prepare(source, source, distance, WAVELENGTH)(field)
    limited = AngularSpectrum().prepare(source, source, distance, WAVELENGTH)(field)
    aliased = AngularSpectrum(band_limit=False).prepare(source, source, distance, WAVELENGTH)(field)
    assert relative(limited, exact) < 0.3 * relative(aliased, exact)


def test_impossible_distances_are_refused() -> None:
    grid = Grid.square(4, 4, 5e-6)
    with pytest.raises(OpticsError, match="distance = nan"):
        AngularSpectrum().prepare(grid, grid, math.nan, WAVELENGTH)
    with pytest.raises(OpticsError, match="padding"):
        AngularSpectrum(padding="some")  # type: ignore[arg-type]


def test_supports_says_why_not() -> None:
    near = Grid.square(64, 64, 4e-6)
    assert "fringes" in AngularSpectrum().supports(near, near, 1.0, WAVELENGTH).reason
    fine = Grid.square(64, 64, 0.5e-6)
    assert AngularSpectrum().supports(fine, fine, 2e-5, WAVELENGTH)
