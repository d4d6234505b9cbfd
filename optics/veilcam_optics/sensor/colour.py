"""From spectra to numbers: CIE XYZ, sRGB and a sensor's own R, G, B.

The 1931 2-degree colour matching functions are the multi-lobe fits of C. Wyman, P.-P. Sloan and
P. Shirley, "Simple Analytic Approximations to the CIE XYZ Color Matching Functions", JCGT 2(2),
2013, table 1: within 1 % of the tables' maxima, and smooth in the wavelength.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from veilcam_optics.errors import OpticsError, invalid, require_positive

# (height, centre, width below, width above) of every lobe [nm].
_X = ((1.056, 599.8, 37.9, 31.0), (0.362, 442.0, 16.0, 26.7), (-0.065, 501.1, 20.4, 26.2))
_Y = ((0.821, 568.8, 46.9, 40.5), (0.286, 530.9, 16.3, 31.1))
_Z = ((1.217, 437.0, 11.8, 36.0), (0.681, 459.0, 26.0, 13.8))

# IEC 61966-2-1, annex F: linear sRGB from XYZ with white at D65.
_SRGB_FROM_XYZ = (
    (3.2406255, -1.5372080, -0.4986286),
    (-0.9689307, 1.8757561, 0.0415175),
    (0.0557101, -0.2040211, 1.0569959),
)


@dataclass(frozen=True, slots=True)
class FilterSet:
    """What a sensor's colour filters pass: one Gaussian each for R, G and B.

    The default stands for a common Bayer sensor without infrared; replace it by what is measured.

    Attributes:
        centres: Wavelengths of the maxima [m].
        widths: Full widths at half maximum [m].
        peaks: Response at the maxima.
    """

    centres: tuple[float, float, float] = (605e-9, 535e-9, 460e-9)
    widths: tuple[float, float, float] = (90e-9, 100e-9, 90e-9)
    peaks: tuple[float, float, float] = (0.9, 1.0, 0.8)

    def __post_init__(self) -> None:
        for name, value in zip("RGB", self.widths, strict=True):
            require_positive(f"widths[{name}]", value, "m")
        for name, value in zip("RGB", self.centres, strict=True):
            require_positive(f"centres[{name}]", value, "m")
        if min(self.peaks) < 0:
            raise invalid("peaks", self.peaks, "", "responses >= 0")

    def response(self, wavelengths: Tensor) -> Tensor:
        """Return the responses at ``wavelengths`` [m], shape (3, n)."""
        lines = [
            peak * torch.exp2(-((2 * (wavelengths - centre) / width) ** 2))
            for centre, width, peak in zip(self.centres, self.widths, self.peaks, strict=True)
        ]
        return torch.stack(lines)

    def rgb(self, wavelengths: Tensor, power: Tensor) -> Tensor:
        """Return what the sensor reads of a spectrum: see :func:`xyz` for the arguments."""
        return _integrate(self.response(wavelengths), wavelengths, power)


def matching_functions(wavelengths: Tensor) -> Tensor:
    """Return the CIE 1931 colour matching functions at ``wavelengths`` [m], shape (3, n)."""
    nanometres = wavelengths.double() * 1e9

    def sum_of_lobes(lobes: tuple[tuple[float, float, float, float], ...]) -> Tensor:
        total = torch.zeros_like(nanometres)
        for height, centre, below, above in lobes:
            # Numbers alone would be rounded to float32.
            width = torch.where(nanometres < centre, nanometres.new_tensor(below), above)
            total = total + height * torch.exp(-0.5 * ((nanometres - centre) / width) ** 2)
        return total

    return torch.stack([sum_of_lobes(_X), sum_of_lobes(_Y), sum_of_lobes(_Z)])


def xyz(wavelengths: Tensor, power: Tensor) -> Tensor:
    """Return the tristimulus values of spectra, scaled so that equal energy has Y = 1.

    Args:
        wavelengths: Increasing, shape (n,) [m].
        power: Spectral power, shape (..., n).

    Returns:
        X, Y and Z, shape (..., 3).

    Raises:
        OpticsError: If shapes differ, the wavelengths do not increase, or none is visible.
    """
    functions = matching_functions(wavelengths)
    white = _integrate(functions[1:2], wavelengths, torch.ones_like(wavelengths))
    if not bool(white > 0):
        raise OpticsError("wavelengths hold nothing visible: use some from 380e-9 to 780e-9 m")
    return _integrate(functions, wavelengths, power) / white.to(power.dtype)


def linear_srgb(tristimulus: Tensor) -> Tensor:
    """Return linear sRGB (..., 3) of X, Y, Z (..., 3); outside [0, 1] if it cannot be shown."""
    matrix = torch.tensor(_SRGB_FROM_XYZ, dtype=tristimulus.dtype, device=tristimulus.device)
    return tristimulus @ matrix.mT


def encode_srgb(linear: Tensor) -> Tensor:
    """Return display values in [0, 1] of linear ones: clipped, then the sRGB curve."""
    clipped = linear.clamp(0, 1)
    curve = 1.055 * clipped.clamp(min=0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(clipped <= 0.0031308, 12.92 * clipped, curve)


def decode_srgb(encoded: Tensor) -> Tensor:
    """Return the linear values of display values in [0, 1]: pictures must be linear to be light."""
    clipped = encoded.clamp(0, 1)
    curve = ((clipped.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4
    return torch.where(clipped <= 0.04045, clipped / 12.92, curve)


def _integrate(functions: Tensor, wavelengths: Tensor, power: Tensor) -> Tensor:
    if wavelengths.ndim != 1 or power.shape[-1:] != wavelengths.shape:
        shapes = f"{tuple(wavelengths.shape)} and {tuple(power.shape)}"
        raise OpticsError(f"wavelengths and power have shapes {shapes}: use (n,) and (..., n)")
    if not bool((wavelengths.diff() > 0).all()):
        raise OpticsError("wavelengths must increase")
    integrand = functions.to(power.dtype) * power[..., None, :]
    if len(wavelengths) == 1:
        return integrand[..., 0]
    return torch.trapezoid(integrand, wavelengths.to(power.dtype), dim=-1)
