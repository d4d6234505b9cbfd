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


class _FresnelIntegrals(torch.autograd.Function):
    """C(t) and S(t); scipy's values with their exact derivatives."""

    @staticmethod
    def forward(ctx: Any, t: Tensor) -> tuple[Tensor, Tensor]:
        ctx.save_for_backward(t)
        sine, cosine = fresnel(t.detach().cpu().numpy())
        return torch.as_tensor(cosine, device=t.device), torch.as_tensor(sine, device=t.device)

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
