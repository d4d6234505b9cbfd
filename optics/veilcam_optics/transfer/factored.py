"""The factored field: a grid of equal rectangles has a field that is a product of 1-D fields.

With ``w`` the weights of the sub-pixels, the field behind the panel is ``U = F w G^T``: ``F[y, r]``
is the field of one row aperture along y, ``G[x, c]`` that of one column aperture along x. Each is a
one-dimensional Fresnel diffraction integral with a closed form, so dead space and pitch are exact
and nothing is padded or aliased.
"""

import math

from veilcam_optics.arrays import Array, Scalar, detached, is_torch_array, namespace
from veilcam_optics.errors import require_positive
from veilcam_optics.transfer.fresnel_integrals import fresnel_integrals


def as_number(value: Scalar) -> float:
    """Return the plain number in a scalar, whether or not it takes part in a gradient."""
    return float(value if isinstance(value, int | float) else detached(value))


def fresnel_integral(t: Array) -> Array:
    """C(t) + i S(t), the integral of exp(i pi u^2 / 2) from 0 to t (DLMF 7.2.7 and 7.2.8).

    Args:
        t: real float64 array of any shape, no unit. Differentiable, twice.

    Returns:
        complex128 array of the same shape. The phase is rounded, so that it is off by about a unit
        of rounding times abs(t).
    """
    if is_torch_array(t):
        # An array of torch is here, so torch is.
        from veilcam_optics.transfer.gradients import FresnelIntegrals  # noqa: PLC0415

        cosine, sine = FresnelIntegrals.apply(t)  # type: ignore[no-untyped-call]
    else:
        cosine, sine = fresnel_integrals(t)
    integral: Array = cosine + 1j * sine
    return integral


def aperture_fields(
    points: Array,
    centres: Array,
    width: Scalar,
    *,
    wavelength: Scalar,
    source_distance: Scalar,
    distance: Scalar,
) -> Array:
    """Field of each of several equal 1-D apertures under a paraxial spherical wave.

    ``F[n, r]`` is the Fresnel integral over aperture ``r`` of
    ``exp(i pi e^2 / (lambda d1)) exp(i pi (y_n - e)^2 / (lambda d2)) / sqrt(i lambda d2)``, by
    completing the square (Goodman, Introduction to Fourier Optics, 3rd ed., section 4.5): equation
    (3) of docs/mathematics.md. The factor ``exp(i pi y^2 / (lambda (d1 + d2)))``, common to all
    apertures, is left out: it cancels in every intensity, and without it the phase stays small.

    Args:
        points: places of the field, shape (N,) [m], float64.
        centres: aperture centres, shape (R,) [m], float64.
        width: aperture width [m].
        wavelength: [m].
        source_distance: point source to aperture [m]; ``math.inf`` for a plane wave.
        distance: aperture to observation [m].

    Returns:
        complex128 array (N, R); an unobstructed plane wave has magnitude 1.

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
    # At once: of the few points of a plan's look the calls take longer than the arithmetic.
    both = fresnel_integral(
        namespace(offset).stack([scale * (offset + width / 2), scale * (offset - width / 2)])
    )
    fields: Array = (shadow / 2) ** 0.5 * (both[0] - both[1])
    return fields
