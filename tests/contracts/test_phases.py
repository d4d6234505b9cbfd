"""Phases in float32 and float64, compared with 40 digits.

A path of 4 m is seven million wavelengths, and float32 has seven digits. So phases are formed in
float64 without the carrier, reduced modulo 2 pi, and only then cast. Stated here, over any
distance from 1 um to 1 km: 1e-6 rad in float32, 1e-8 rad in float64. Only where the phase itself is
above 1e7 rad, which no float64 holds to 1e-8, is it what rounding leaves of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeAlias

import mpmath  # type: ignore[import-untyped]
import pytest
import torch
from torch import Tensor

from veilcam_optics.errors import OpticsError
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.base import unit_phasor
from veilcam_optics.propagation.illumination import spherical_wave
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.transfer.factored import aperture_fields

from .contracts import relative

Number: TypeAlias = Any
Turns = Callable[[Number, Number, Number], Number]
"""Phase in turns as a function of a position or frequency, a distance and a wavelength."""

WAVELENGTH = 550e-9
SAMPLES = Grid.square(1, 64, 12.4e-6)

distances = pytest.mark.parametrize("distance", [1e-6, 4e-3, 0.4, 4.0, 1e3])
both_types = pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128], ids=str)
TOLERANCES = {torch.complex64: 1e-6, torch.complex128: 1e-8}


def phase_error(got: Tensor, turns: Turns, at: list[Number], distance: float) -> float:
    """Largest angle between ``got`` and exp(2 pi i turns), up to one common phase of i^n [rad]."""
    with mpmath.workdps(40):
        z, wavelength = mpmath.mpf(distance), mpmath.mpf(WAVELENGTH)
        exact = [complex(mpmath.expjpi(2 * turns(a, z, wavelength))) for a in at]
    wanted = torch.tensor(exact, dtype=torch.complex128)
    return float((got.to(torch.complex128) * wanted.conj()).angle().abs().max())


def positions(centre: float = 0.0) -> list[Number]:
    """The samples' positions, without the rounding of float64."""
    with mpmath.workdps(40):
        pitch = mpmath.mpf(float(SAMPLES.pitch_x))
        return [(2 * i - 63) * pitch / 2 + mpmath.mpf(centre) for i in range(64)]


def spherical(x: Number, z: Number, wavelength: Number) -> Number:
    return (mpmath.sqrt(x * x + z * z) - z) / wavelength


def paraxial(x: Number, z: Number, wavelength: Number) -> Number:
    return x * x / (2 * wavelength * z)


@distances
@both_types
def test_angular_spectrum_transfer(distance: float, dtype: torch.dtype) -> None:
    """A point's spectrum after a periodic propagation is the transfer function itself."""
    run = AngularSpectrum(padding="none", band_limit=False).prepare(
        SAMPLES, SAMPLES, distance, WAVELENGTH, dtype=dtype
    )
    point = torch.zeros(SAMPLES.shape, dtype=dtype)
    point[0, 0] = 1
    # The transforms add a rounding of their own, here and inside.
    spectrum = torch.fft.fft(run(point)[0].to(torch.complex128))

    def turns(order: Number, z: Number, wavelength: Number) -> Number:
        s = (wavelength * order / (64 * mpmath.mpf(float(SAMPLES.pitch_x)))) ** 2
        return z / wavelength * (mpmath.sqrt(1 - s) - 1)

    orders = [mpmath.mpf(n) for n in (*range(32), *range(-32, 0))]
    assert phase_error(spectrum, turns, orders, distance) < TOLERANCES[dtype]
    assert float((spectrum.abs() - 1).abs().max()) < TOLERANCES[dtype]


@distances
@both_types
@pytest.mark.parametrize(("exact", "turns"), [(True, spherical), (False, paraxial)])
def test_illumination(exact: bool, turns: Turns, distance: float, dtype: torch.dtype) -> None:
    grid = Grid(1, 64, 12.4e-6, 12.4e-6, centre_x=2e-3)
    wave = spherical_wave(grid, distance, WAVELENGTH, paraxial=not exact, dtype=dtype)[0]
    at = positions(2e-3)
    # Of the phase: 2 roundings of a position count twice in its square, and 4 operations follow.
    # At a micrometre it is 3e7 rad, of which one rounding is 4e-9.
    phase = 2 * math.pi * max(float(turns(x, distance, WAVELENGTH)) for x in at)
    rounding = 8 * 2**-53 * phase
    assert phase_error(wave, turns, at, distance) < TOLERANCES[dtype] + rounding


@both_types
def test_reduction_modulo_a_turn(dtype: torch.dtype) -> None:
    """Ten million turns and a bit, of either sign."""
    turns = torch.tensor([1e7 + 0.125, -1e7 - 0.375, 0.0, 0.5, 1e-9], dtype=torch.float64)
    got = unit_phasor(2 * torch.pi * turns, dtype)
    wanted = torch.exp(2j * torch.pi * (turns - turns.round()))
    # 1e7 turns are 6e7 rad; half a unit in float64's last place there is 4e-9 rad.
    assert float((got.to(torch.complex128) - wanted).abs().max()) < max(TOLERANCES[dtype], 2e-8)
    with pytest.raises(OpticsError, match="float64"):
        unit_phasor(torch.zeros(3), dtype)


@pytest.mark.parametrize(
    ("source_distance", "distance"),
    [(0.4, 4e-3), (0.4, 1e-6), (0.55, 0.4), (20.0, 4.0), (5e4, 1e3), (float("inf"), 4e-3)],
)
def test_factored_field(source_distance: float, distance: float) -> None:
    """The closed form of one aperture, far off its axis too, by 40-digit Fresnel integrals."""
    width, centre = 60e-6, 1.8e-3
    points = torch.linspace(-3e-3, 3e-3, 41, dtype=torch.float64)
    got = aperture_fields(
        points,
        torch.tensor([centre], dtype=torch.float64),
        width,
        wavelength=WAVELENGTH,
        source_distance=source_distance,
        distance=distance,
    )[:, 0]
    wanted = []
    with mpmath.workdps(40):
        d1, d2 = mpmath.mpf(source_distance), mpmath.mpf(distance)
        shadow = 1 / (1 + d2 / d1)
        scale = mpmath.sqrt(2 / (mpmath.mpf(WAVELENGTH) * d2 * shadow))
        for y in points.tolist():
            ends = [
                scale * (mpmath.mpf(centre) - mpmath.mpf(y) * shadow + side * mpmath.mpf(width) / 2)
                for side in (1, -1)
            ]
            upper, lower = (mpmath.mpc(mpmath.fresnelc(t), mpmath.fresnels(t)) for t in ends)
            wanted.append(complex(mpmath.sqrt(shadow / 2) * (upper - lower)))
    assert relative(got, torch.tensor(wanted, dtype=torch.complex128)) < 1e-9
