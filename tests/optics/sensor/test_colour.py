"""Spectra to XYZ, sRGB and a sensor's own numbers."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from veilcam_optics.errors import OpticsError
from veilcam_optics.sensor.colour import (
    FilterSet,
    decode_srgb,
    encode_srgb,
    linear_srgb,
    matching_functions,
    xyz,
)

VISIBLE = torch.linspace(380e-9, 780e-9, 401, dtype=torch.float64)


def line(wavelength: float) -> torch.Tensor:
    return torch.exp(-(((VISIBLE - wavelength) / 3e-9) ** 2))


def test_equal_energy_is_white() -> None:
    values = xyz(VISIBLE, torch.ones_like(VISIBLE))
    assert float(values[1]) == pytest.approx(1, abs=1e-12)
    chromaticity = values / values.sum()
    assert float((chromaticity - 1 / 3).abs().max()) < 2e-3


@pytest.mark.parametrize(
    ("nanometres", "wanted"),
    # CIE 15, table T.4: values of the 1931 functions.
    [
        (450, (0.3362, 0.0380, 1.7721)),
        (555, (0.5121, 1.0000, 0.0057)),
        (600, (1.0622, 0.6310, 0.0008)),
    ],
)
def test_matching_functions_are_those_of_the_table(
    nanometres: int, wanted: tuple[float, float, float]
) -> None:
    got = matching_functions(torch.tensor([nanometres * 1e-9]))[:, 0]
    assert float((got - torch.tensor(wanted)).abs().max()) < 0.03


def test_chromaticity_of_a_green_laser() -> None:
    """532 nm lies at (0.170, 0.797) on the spectral locus."""
    values = xyz(VISIBLE, line(532e-9))
    chromaticity = (values / values.sum()).tolist()
    assert chromaticity[:2] == pytest.approx([0.170, 0.797], abs=0.02)


def test_srgb_of_d65_is_white_and_curves_invert() -> None:
    white = torch.tensor([0.95047, 1.0, 1.08883], dtype=torch.float64)
    assert torch.allclose(linear_srgb(white), torch.ones(3, dtype=torch.float64), atol=3e-4)
    linear = torch.linspace(0, 1, 101, dtype=torch.float64)
    encoded = encode_srgb(linear)
    assert torch.allclose(decode_srgb(encoded), linear, atol=1e-6)
    assert float(encode_srgb(torch.tensor(0.2140))) == pytest.approx(0.5, abs=1e-3)
    dark = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(encode_srgb(dark).sum(), dark)
    assert bool(torch.isfinite(gradient).all())


def test_each_filter_sees_its_own_colour() -> None:
    filters = FilterSet()
    seen = torch.stack([filters.rgb(VISIBLE, line(nm * 1e-9)) for nm in (640, 550, 460)])
    assert seen.argmax(1).tolist() == [0, 1, 2]
    narrow = dataclasses.replace(filters, widths=(20e-9, 20e-9, 20e-9))
    assert float(narrow.rgb(VISIBLE, line(550e-9))[0]) < float(seen[1, 0])
    assert float(filters.response(torch.tensor([535e-9]))[1, 0]) == pytest.approx(1.0)
    half = filters.response(torch.tensor([585e-9], dtype=torch.float64))[1, 0]
    assert float(half) == pytest.approx(0.5)


def test_a_single_wavelength_needs_no_interval() -> None:
    one = torch.tensor([550e-9], dtype=torch.float64)
    assert FilterSet().rgb(one, torch.ones(1, dtype=torch.float64)).shape == (3,)


def test_bad_spectra_are_refused() -> None:
    with pytest.raises(OpticsError, match="shapes"):
        xyz(VISIBLE, torch.ones(5, dtype=torch.float64))
    with pytest.raises(OpticsError, match="increase"):
        xyz(VISIBLE.flip(0), torch.ones_like(VISIBLE))
    with pytest.raises(OpticsError, match=r"widths\[G\]"):
        FilterSet(widths=(1e-8, 0.0, 1e-8))
    with pytest.raises(OpticsError, match="peaks"):
        FilterSet(peaks=(1.0, -1.0, 1.0))
