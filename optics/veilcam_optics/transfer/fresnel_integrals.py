"""Fresnel integrals C and S, of arrays of NumPy or of torch.

By the auxiliary functions f and g, which do not oscillate (DLMF 7.5.3 and 7.5.4),

    C(t) = 1/2 + f sin(pi t^2 / 2) - g cos(pi t^2 / 2),
    S(t) = 1/2 - f cos(pi t^2 / 2) - g sin(pi t^2 / 2)        for t >= 0.

Far from zero they are asymptotic series in 1 / t^4 (DLMF 7.12.2 and 7.12.3), near it polynomials.
"""

import math

from veilcam_optics.arrays import Array, namespace

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


def _series(start: int) -> tuple[float, ...]:
    """Taylor's of the cosine (0) or the sine (1) of a quarter of a turn; the next is below 1e-17.

    By powers of the square.
    """
    return tuple(
        (-1) ** k * (math.pi / 2) ** (2 * k + start) / math.factorial(2 * k + start)
        for k in range(11)
    )


_COSINE, _SINE = _series(0), _series(1)

_BEND = 3.0
"""Near zero, f and g are polynomials in (t - _BEND) / (t + _BEND), scaled to [-1, 1]."""

# What interpolates f and g there at 32 Chebyshev nodes, lowest power first. The test of this module
# computes it again with mpmath; fewer nodes are seen in the last digits.
# fmt: off
_NEAR_F = (
    0.18063074582400349, -0.2579574732700225, 0.18139257160416872, -0.05995079551792775,
    -0.056078540640053055, 0.10194646741827249, -0.06327465362659615, -0.004457187441511992,
    0.03463193010601497, -0.017082471935636206, -0.008048172385599515, 0.010724840770020476,
    0.00016576823135711297, -0.0046321628384318235, 0.0008244825345266343,
    0.0018037635346451369, -0.0005108237172076071, -0.0007028023973827921,
    0.00021632134579381706, 0.0002831505277909454, -7.218725350482295e-05,
    -0.00011551230293622632, 1.8019360379774777e-05, 4.5066554244974106e-05,
    -2.4985853612580637e-06, -1.5522072486458213e-05, -2.245331087869971e-07,
    4.253981970144078e-06, 1.817620709057437e-07, -7.965944203385627e-07,
    -2.7223391451352386e-08, 7.438730466279322e-08,
)
_NEAR_G = (
    0.017780222214138785, -0.07326627707427054, 0.14594718389120312, -0.17955028481974064,
    0.13472038290985566, -0.03548951505322021, -0.044521501563179126, 0.053927874282856815,
    -0.013369883007520744, -0.018357141031484853, 0.014659764031105447, 0.0025997439598853265,
    -0.007214616616683799, 0.0006866990209718041, 0.002903322321147461, -0.0006973879037603917,
    -0.0011214350874689087, 0.00034276477114121443, 0.0004431791438700843,
    -0.000127770672164424, -0.00017906014670600833, 3.630631641366837e-05,
    7.026467689933841e-05, -6.001180444690063e-06, -2.460742283250325e-05,
    -7.408545242640761e-07, 6.884742439531189e-06, 8.725987653859981e-07,
    -1.315223221287284e-06, -2.6459775709686594e-07, 1.2494835439655764e-07,
    3.204873434238536e-08,
)
# fmt: on


def fresnel_integrals(t: Array) -> tuple[Array, Array]:
    """C(t) and S(t) of a float64 array; no gradient passes."""
    xp = namespace(t)
    flat = xp.reshape(t, (-1,))
    cosine, sine = xp.empty_like(flat), xp.empty_like(flat)
    for start in range(0, flat.shape[0], _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        cosine[some], sine[some] = _some_integrals(flat[some])
    return xp.reshape(cosine, t.shape), xp.reshape(sine, t.shape)


def _some_integrals(t: Array) -> tuple[Array, Array]:
    xp = namespace(t)
    size = xp.clip(xp.abs(t), 0, _FARTHEST)
    square = size * size
    f, g = _far_functions(size, square)
    near = xp.nonzero(size < _FAR)[0]
    f[near], g[near] = _near_functions(size[near])
    sine, cosine = _waves(square)
    sign = xp.sign(t)
    return sign * (0.5 + f * sine - g * cosine), sign * (0.5 - f * cosine - g * sine)


def _waves(square: Array) -> tuple[Array, Array]:
    """Sine and cosine of ``pi square / 2``: NumPy's own take twice as long.

    Whole turns are left out without any rounding, and half the angle is doubled.
    """
    rest = square / 4
    rest -= namespace(square).round(rest)
    rest *= 2
    squared = rest * rest
    sine, cosine = _polynomial(_SINE, squared), _polynomial(_COSINE, squared)
    sine *= rest
    double = sine * cosine
    double *= 2
    cosine *= cosine
    sine *= sine
    cosine -= sine
    return double, cosine


def _far_functions(size: Array, square: Array) -> tuple[Array, Array]:
    """F and g from ``_FAR`` on; below, something finite."""
    xp = namespace(size)
    inverse = (2 / math.pi) / xp.clip(square, _FAR**2, None)
    fourth = inverse * inverse
    f, g = _polynomial(_F, fourth), _polynomial(_G, fourth)
    scale = 1 / (math.pi * xp.clip(size, _FAR, None))
    f *= scale
    scale *= inverse
    g *= scale
    return f, g


def _near_functions(size: Array) -> tuple[Array, Array]:
    """F and g from zero to ``_FAR``."""
    place = (size - _BEND) / (size + _BEND)
    last = (_FAR - _BEND) / (_FAR + _BEND)
    place += 1
    place *= 2 / (last + 1)
    place -= 1
    return _polynomial(_NEAR_F, place), _polynomial(_NEAR_G, place)


def _polynomial(coefficients: tuple[float, ...], x: Array) -> Array:
    """By Horner's rule, lowest power first."""
    total: Array = namespace(x).full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total *= x
        total += coefficient
    return total
