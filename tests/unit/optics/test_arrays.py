"""Arrays of NumPy and of torch: what the array API standard lacks, alike for both."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

from veilcam_optics.arrays import (
    as_type,
    cholesky,
    detached,
    ends,
    needs_gradient,
    overwrite,
    solve_triangular,
)

Values = npt.NDArray[Any]
UNITS = {"float32": 2.0**-24, "float64": 2.0**-53}


def lower(size: int, name: str) -> Values:
    """A factor as decoders have it: of a matrix with eigenvalues of 1 and more."""
    random = np.random.default_rng(size)
    rows = random.normal(size=(size, 2 * size))
    factor: Values = np.linalg.cholesky(np.eye(size) + rows @ rows.T).astype(name)
    return factor


@pytest.mark.parametrize("name", UNITS)
@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize("size", [1, 3, 63, 64, 65, 130])
@pytest.mark.parametrize("columns", [0, 1, 5])
def test_triangle_is_solved_alike(size: int, columns: int, transposed: bool, name: str) -> None:
    factor = lower(size, name)
    # What is above the diagonal is not looked at.
    given = factor + np.triu(np.full((size, size), np.nan, name), 1)
    right = np.random.default_rng(1).normal(size=(size, columns)).astype(name)
    matrix = factor.T if transposed else factor
    for solved in (
        solve_triangular(given, right, transposed=transposed),
        solve_triangular(
            torch.from_numpy(given), torch.from_numpy(right), transposed=transposed
        ).numpy(),
    ):
        assert solved.dtype == right.dtype
        # Substitution is stable backwards (Higham 2002, theorem 8.5): what is left is at most
        # size x unit of |L| |x|; a block solved with pivots may add as many times its growth.
        left = np.abs(matrix @ solved - right)
        allowed = 10 * (size + 1) * UNITS[name] * (np.abs(matrix) @ np.abs(solved))
        assert (left <= allowed).all()


@pytest.mark.parametrize("library", [np.asarray, torch.tensor])
def test_matrix_that_has_no_factor(library: Any) -> None:
    definite = np.array([[4.0, 2.0], [2.0, 5.0]])
    found = cholesky(library(definite))
    assert np.allclose(np.asarray(found), [[2, 0], [1, 2]], rtol=1e-15, atol=0)
    assert cholesky(library(np.array([[1.0, 2.0], [2.0, 1.0]]))) is None
    for value in (np.nan, np.inf):
        assert cholesky(library(np.array([[4.0, value], [value, 5.0]]))) is None


@pytest.mark.parametrize("name", UNITS)
@pytest.mark.parametrize("inference", [True, False])
def test_overwritten_arrays_are_zeros_through_every_view(name: str, inference: bool) -> None:
    with torch.inference_mode(inference):
        tensor = torch.ones(3, 4, dtype=getattr(torch, name))
    array = np.ones((3, 4), name)
    overwrite(tensor.T, torch.ones(()))
    overwrite(array.T[::-1])
    assert not array.any()
    assert not bool(tensor.any())


def test_number_has_the_type_that_is_asked_for() -> None:
    array, tensor = np.ones(2, np.float32), torch.ones(2)
    assert as_type(array, "float64").dtype == np.float64
    assert as_type(tensor, "float64").dtype == torch.float64
    # Nothing is copied without need: it would have to be overwritten, too.
    assert as_type(array, "float32") is array
    assert as_type(tensor, "float32") is tensor


def test_gradients_are_torch_s_alone() -> None:
    learned = torch.ones(2, requires_grad=True)
    assert needs_gradient(learned)
    assert not needs_gradient(detached(learned))
    assert not needs_gradient(np.ones(2))
    assert bool((detached(learned) == 1).all())
    array = np.ones(2)
    assert detached(array) is array


def test_ends_of_an_array() -> None:
    values = np.array([[0.5, -2.0], [7.0, 1.0]])
    assert ends(values) == ends(torch.tensor(values, requires_grad=True)) == (-2.0, 7.0)
    values[1, 1] = np.nan
    assert np.isnan(ends(values)).all()
    assert np.isnan(ends(torch.tensor(values))).all()
