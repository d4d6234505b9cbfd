"""Arrays of NumPy or of torch: what the device and training have in common is written once.

``namespace(array)`` has the functions of the array API standard (data-apis.org/array-api, 2024.12)
for an array of either library, and gradients pass through those of torch. What that standard lacks
is here: overwriting secrets, numbers without a gradient, and factors of matrices.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt
from array_api_compat import array_namespace, device, is_torch_array, to_device
from typing_extensions import TypeVar

if TYPE_CHECKING:
    from torch import Tensor

__all__ = [
    "Array",
    "Scalar",
    "as_numpy",
    "as_type",
    "cholesky",
    "detached",
    "device",
    "ends",
    "is_torch_array",
    "namespace",
    "needs_gradient",
    "overwrite",
    "solve_triangular",
    "to_device",
]

Array = TypeVar("Array", "npt.NDArray[Any]", "Tensor", default="Tensor")
"""Of NumPy or of torch; what takes one gives the same back."""

Scalar: TypeAlias = Any
"""A float, or a scalar array of any library, so that gradients reach a length or an angle."""

_BLOCK = 64
"""Rows that are solved for at once: a matrix of so many a side stays in a processor's cache."""


_STANDARD = hasattr(np, "cumulative_sum")
"""NumPy keeps to the standard by itself, as it does from 2.1 on."""


def namespace(array: Array) -> Any:
    """Return the functions of the array's library, as the standard has them."""
    # What makes older ones compatible loads all that NumPy has, its front of Fortran included.
    return np if _STANDARD and isinstance(array, np.ndarray) else array_namespace(array)


def as_type(array: Array, name: str) -> Array:
    """Return the same numbers as ``float32`` or ``float64``; no copy where the type is right."""
    xp = namespace(array)
    same: Array = xp.astype(array, getattr(xp, name), copy=False)
    return same


def as_numpy(array: Array) -> npt.NDArray[Any]:
    """Return the same numbers in NumPy, in the same memory where that is possible."""
    return np.asarray(to_device(detached(array), "cpu"))


def detached(array: Array) -> Array:
    """Return the same numbers, without their gradient."""
    return array.detach() if is_torch_array(array) else array


def needs_gradient(array: Array) -> bool:
    """Return whether torch records what is made of it."""
    return is_torch_array(array) and bool(array.requires_grad)


def ends(array: Array) -> tuple[float, float]:
    """Smallest and largest number of a real array that is not empty; NaN, both, if one is NaN."""
    if is_torch_array(array):  # in one pass
        low, high = array.detach().aminmax()
    else:
        low, high = array.min(), array.max()
    return float(low), float(high)


def overwrite(*arrays: Array) -> None:
    """Fill arrays with zeros, whatever mode of torch made them; copies elsewhere stay."""
    for array in arrays:
        if is_torch_array(array):
            import torch  # noqa: PLC0415 - an array of torch is here, so torch is

            with torch.inference_mode():
                array.zero_()
        else:
            array[...] = 0


def cholesky(matrix: Array) -> Array | None:
    """Lower factor (N, N) of a symmetric matrix, or None where it is not positive definite."""
    xp = namespace(matrix)
    factor: Array
    if is_torch_array(matrix):
        factor, failure = xp.linalg.cholesky_ex(matrix)
        return None if int(failure) else factor
    try:
        factor = xp.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return None
    # Not every LAPACK takes NaN for a failure.
    return factor if bool(xp.all(xp.isfinite(factor))) else None


def solve_triangular(factor: Array, right: Array, *, transposed: bool = False) -> Array:
    """Solve ``factor x = right``, or ``factor^T x = right``, for a lower triangular factor.

    Args:
        factor: (N, N); what is above the diagonal is not looked at.
        right: (N, M).
        transposed: solve with the transposed factor.

    Returns:
        (N, M).
    """
    if is_torch_array(factor):
        solve = namespace(factor).linalg.solve_triangular
        solved: Array = solve(factor.T if transposed else factor, right, upper=transposed)
        return solved
    if transposed:  # from the last row to the first, an upper triangle is a lower one
        return _substituted(factor.T[::-1, ::-1], right[::-1])[::-1]
    return _substituted(factor, right)


def _substituted(factor: npt.NDArray[Any], right: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Forward substitution, block by block: NumPy has none (Higham 2002, section 13.1)."""
    solved = right.copy()
    for start in range(0, len(factor), _BLOCK):
        here = slice(start, start + _BLOCK)
        rest = solved[here] - factor[here, :start] @ solved[:start]
        solved[here] = np.linalg.solve(np.tril(factor[here, here]), rest)
    return solved
