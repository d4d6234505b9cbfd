"""The factored field: a grid of equal rectangles has a field that is a product of 1-D fields.

With ``w`` the weights of the sub-pixels, the field behind the panel is ``U = F w G^T``: ``F[y, r]``
is the field of one row aperture along y, ``G[x, c]`` that of one column aperture along x. Each is a
one-dimensional Fresnel diffraction integral with a closed form, so dead space and pitch are exact
and nothing is padded or aliased.
"""

import math
from typing import Any

import torch
from scipy.special import fresnel
from torch import Tensor

from veilcam_optics.errors import require_positive


def as_number(value: float | Tensor) -> float:
    """The plain number in a scalar, whether or not it takes part in a gradient."""
    return float(value.detach()) if isinstance(value, Tensor) else value


_FAR = 8.0
"""From here on the asymptotic series is exact to rounding."""

_FARTHEST = 1e17
"""Beyond, a half to rounding: the square of infinity has no phase."""

_TERMS = 6
"""Of each series. The first one left out is below 1e-17 at ``_FAR``, and bounds the remainder."""

_AT_ONCE = 2**14
"""Arguments whose intermediate values fit in a processor's cache."""


def _pochhammer(start: int) -> tuple[float, ...]:
    """(-1)^m (1/2)_(2m + start), the coefficients of DLMF 7.12.2 and 7.12.3."""
    return tuple(
        (-1) ** m * math.prod(k + 0.5 for k in range(2 * m + start)) for m in range(_TERMS)
    )


_F, _G = _pochhammer(0), _pochhammer(1)


def _polynomial(coefficients: tuple[float, ...], x: Tensor) -> Tensor:
    """By Horner's rule, lowest power first."""
    total = torch.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total.mul_(x).add_(coefficient)
    return total


def _far_integrals(t: Tensor) -> tuple[Tensor, Tensor]:
    """C(t) and S(t) where abs(t) is at least ``_FAR``; elsewhere something finite."""
    size = t.abs().clamp_(_FAR, _FARTHEST)
    phase = size.square().mul_(math.pi / 2)
    inverse = phase.reciprocal()
    square = inverse.square()
    f, g = _polynomial(_F, square), _polynomial(_G, square).mul_(inverse)
    sine, cosine = phase.sin(), phase.cos()
    # f and g share the factor 1 / (pi t), which is odd like C and S.
    scale = torch.copysign(size.mul_(math.pi).reciprocal_(), t)
    half = torch.copysign(torch.full_like(t, 0.5), t)
    c = torch.addcmul(half, (f * sine).addcmul_(g, cosine, value=-1), scale)
    s = torch.addcmul(half, f.mul_(cosine).addcmul_(g, sine), scale, value=-1)
    return c, s


def _integrals(t: Tensor) -> tuple[Tensor, Tensor]:
    """C(t) and S(t) of a float64 tensor in main memory.

    Far from zero by the auxiliary functions' asymptotic series (DLMF 7.5.3, 7.5.4 and 7.12.2 to
    7.12.3), in half the time of scipy's, which takes the rest. Both round the phase, so that they
    differ by about a unit of rounding times abs(t).
    """
    found = torch.empty(2, t.numel(), dtype=t.dtype)
    for some, c, s in zip(
        torch.split(t.flatten(), _AT_ONCE),
        *(torch.split(of, _AT_ONCE) for of in found),
        strict=True,
    ):
        near = (some.abs() < _FAR).nonzero().flatten()
        for integral, value in zip((c, s), _far_integrals(some), strict=True):
            integral.copy_(value)
        sine, cosine = fresnel(some[near].numpy())
        c[near], s[near] = torch.from_numpy(cosine), torch.from_numpy(sine)
    return found[0].reshape(t.shape), found[1].reshape(t.shape)


class _FresnelIntegrals(torch.autograd.Function):
    """C(t) and S(t), with their exact derivatives."""

    @staticmethod
    def forward(ctx: Any, t: Tensor) -> tuple[Tensor, Tensor]:
        ctx.save_for_backward(t)
        cosine, sine = _integrals(t.detach().cpu())
        return cosine.to(t.device), sine.to(t.device)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        (t,) = ctx.saved_tensors
        phase = torch.pi / 2 * t * t
        return gradients[0] * torch.cos(phase) + gradients[1] * torch.sin(phase)


def fresnel_integral(t: Tensor) -> Tensor:
    """C(t) + i S(t), the integral of exp(i pi u^2 / 2) from 0 to t (DLMF 7.2.7 and 7.2.8).

    Args:
        t: real float64 tensor of any shape, no unit. Differentiable, twice.

    Returns:
        complex128 tensor of the same shape.
    """
    cosine, sine = _FresnelIntegrals.apply(t)  # type: ignore[no-untyped-call]
    return torch.complex(cosine, sine)


def aperture_fields(
    points: Tensor,
    centres: Tensor,
    width: float | Tensor,
    *,
    wavelength: float | Tensor,
    source_distance: float | Tensor,
    distance: float | Tensor,
) -> Tensor:
    """Field of each of several equal 1-D apertures under a paraxial spherical wave.

    ``F[n, r]`` is the Fresnel integral over aperture ``r`` of
    ``exp(i pi e^2 / (lambda d1)) exp(i pi (y_n - e)^2 / (lambda d2)) / sqrt(i lambda d2)``, by
    completing the square (Goodman, Introduction to Fourier Optics, 3rd ed., section 4.5): equation
    (3) of docs/mathematics.md. The factor ``exp(i pi y^2 / (lambda (d1 + d2)))``, common to all
    apertures, is left out: it cancels in every intensity, and without it the phase stays small.

    Args:
        points: where the field is wanted, shape (N,) [m], float64.
        centres: aperture centres, shape (R,) [m], float64.
        width: aperture width [m].
        wavelength: [m].
        source_distance: point source to aperture [m]; ``math.inf`` for a plane wave.
        distance: aperture to observation [m].

    Returns:
        complex128 tensor (N, R); an unobstructed plane wave has magnitude 1.

    Raises:
        OpticsError: a width, wavelength or distance is not a positive number.
    """
    for name, value, finite in (
        ("width", width, True),
        ("wavelength", wavelength, True),
        ("source_distance", source_distance, False),
        ("distance", distance, True),
    ):
        number = as_number(value)
        if finite or number != math.inf:
            require_positive(name, number, "m")
    # 1/D = 1/d1 + 1/d2; shadow = D/d2 = d1/(d1+d2) maps the observation point to the aperture.
    shadow = 1 / (1 + distance / source_distance)
    effective = distance * shadow
    scale = (2 / (wavelength * effective)) ** 0.5
    offset = centres - points[:, None] * shadow
    upper = fresnel_integral(scale * (offset + width / 2))
    lower = fresnel_integral(scale * (offset - width / 2))
    amplitude: float | Tensor = (shadow / 2) ** 0.5
    return amplitude * (upper - lower)
