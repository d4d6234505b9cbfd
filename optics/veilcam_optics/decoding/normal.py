"""Normal numbers from uniform ones: the inverse of the normal distribution, in NumPy alone.

Algorithm AS 241 (Wichura, Applied Statistics 37, 1988, 477-484): three quotients of polynomials,
each within a few units of rounding of the exact value.
"""

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[np.float64]

# Coefficients of the numerators and denominators, lowest power first.
# fmt: off
_CENTRE = (
    (
        3.3871328727963665, 133.14166789178438, 1971.5909503065513, 13731.69376550946,
        45921.95393154987, 67265.7709270087, 33430.57558358813, 2509.0809287301227,
    ),
    (
        1.0, 42.31333070160091, 687.1870074920579, 5394.196021424751, 21213.794301586597,
        39307.89580009271, 28729.085735721943, 5226.495278852854,
    ),
)
_TAIL = (
    (
        1.4234371107496835, 4.630337846156546, 5.769497221460691, 3.6478483247632045,
        1.2704582524523684, 0.2417807251774506, 0.022723844989269184, 0.0007745450142783414,
    ),
    (
        1.0, 2.053191626637759, 1.6763848301838038, 0.6897673349851, 0.14810397642748008,
        0.015198666563616457, 0.0005475938084995345, 1.0507500716444169e-09,
    ),
)
_FAR = (
    (
        6.657904643501103, 5.463784911164114, 1.7848265399172913, 0.29656057182850487,
        0.026532189526576124, 0.0012426609473880784, 2.7115555687434876e-05,
        2.0103343992922881e-07,
    ),
    (
        1.0, 0.599832206555888, 0.1369298809227358, 0.014875361290850615, 0.0007868691311456133,
        1.8463183175100548e-05, 1.421511758316446e-07, 2.0442631033899397e-15,
    ),
)
# fmt: on

_HALF_CENTRE = 0.425
"""Probabilities as far from 1/2 are the centre's."""

_TAIL_ENDS = 5.0
"""Root of the logarithm where a tail goes on as the far one: a probability of 1e-11."""


_AT_ONCE = 2**13
"""Numbers whose intermediate values fit in a processor's cache."""


def normal(drawn: npt.NDArray[np.uint8]) -> Values:
    """Draw normal numbers, float64, one from every 8 uniform bytes."""
    words = drawn.view("<u8") >> np.uint64(11)
    # The last of 2^53 words would be rounded to a probability of 1, whose number is infinite.
    numbers: Values = np.minimum((words + 0.5) * 2.0**-53, 1 - 2.0**-53)
    for start in range(0, numbers.size, _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        numbers[some] = inverse_normal(numbers[some])
    return numbers


def inverse_normal(probability: Values) -> Values:
    """Return the quantile of the standard normal distribution, element by element.

    Args:
        probability: probabilities in (0, 1), any shape.
    """
    centred = probability - 0.5
    square = np.square(centred)
    found: Values = centred * _quotient(_CENTRE, _HALF_CENTRE**2 - square)
    outside = np.nonzero(square > _HALF_CENTRE**2)
    tail = np.minimum(probability[outside], 1 - probability[outside])
    root = np.sqrt(-np.log(tail))
    size = np.where(
        root <= _TAIL_ENDS, _quotient(_TAIL, root - 1.6), _quotient(_FAR, root - _TAIL_ENDS)
    )
    found[outside] = np.copysign(size, centred[outside])
    return found


def _quotient(coefficients: tuple[tuple[float, ...], tuple[float, ...]], at: Values) -> Values:
    """Return the quotient of two polynomials."""
    quotient = _polynomial(coefficients[0], at)
    quotient /= _polynomial(coefficients[1], at)
    return quotient


def _polynomial(coefficients: tuple[float, ...], at: Values) -> Values:
    """By Horner's rule, in place: NumPy's own takes half as long again."""
    total = np.full_like(at, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total *= at
        total += coefficient
    return total
