"""Least squares between bounds: what SciPy finds, and where a bound is in the way."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy import optimize

from veilcam_server.calibration.response import Fit, least_squares

Values = npt.NDArray[np.float64]


def linear(matrix: Values, seen: Values, lowest: float) -> Fit:
    return least_squares(
        lambda x: matrix @ x - seen, lambda _: matrix, np.zeros(matrix.shape[1]), lowest=lowest
    )


@pytest.mark.parametrize("seed", range(20))
def test_shares_that_are_not_negative_are_those_of_scipy(seed: int) -> None:
    random = np.random.default_rng(seed)
    # Columns of very different size, as of an open panel and of a dead line.
    matrix = random.random((30, 3)) * [1.0, 1e-3, 10.0]
    seen = random.standard_normal(30)
    found, (wanted, _) = linear(matrix, seen, lowest=0.0), optimize.nnls(matrix, seen)
    assert (found.values >= 0).all()
    left = np.linalg.norm(found.residuals)
    assert left == pytest.approx(np.linalg.norm(matrix @ wanted - seen), rel=1e-9)
    np.testing.assert_allclose(found.residuals, matrix @ found.values - seen)


@pytest.mark.parametrize("seed", range(20))
def test_power_law_is_that_of_scipy(seed: int) -> None:
    random = np.random.default_rng(seed)
    weights = np.linspace(0, 1, 16)
    truth = random.uniform([0.5, 0.7, 0.0], [2.0, 2.5, 0.3])
    noise = 1e-3 * random.standard_normal(16)

    def light(values: Values) -> Values:
        scale, gamma, floor = values
        shown: Values = scale * (floor + (1 - floor) * weights**gamma) ** 2
        return shown

    def residuals(values: Values) -> Values:
        return light(values) - light(truth) - noise

    def jacobian(values: Values) -> Values:
        steps = 1e-6 * np.eye(3)
        return np.stack([(light(values + s) - light(values - s)) / 2e-6 for s in steps], axis=1)

    lowest, highest = np.array([0.01, 0.1, 0.0]), np.array([4.0, 10.0, 0.99])
    start = np.array([1.0, 1.0, 0.1])
    found = least_squares(residuals, jacobian, start, lowest=lowest, highest=highest)
    wanted = optimize.least_squares(residuals, start, bounds=(lowest, highest), xtol=1e-12)
    assert found.residuals @ found.residuals <= 2 * wanted.cost * (1 + 1e-4)
    np.testing.assert_allclose(found.values, wanted.x, atol=2e-3)


def test_start_out_of_bounds_ends_within() -> None:
    found = least_squares(
        lambda x: x - [5.0, 0.5],
        lambda _: np.eye(2),
        np.array([-3.0, 9.0]),
        lowest=np.array([0.0, 0.0]),
        highest=np.array([1.0, 1.0]),
    )
    np.testing.assert_allclose(found.values, [1.0, 0.5], atol=1e-6)


def test_solver_asks_no_oftener_than_it_may() -> None:
    asked = []

    def residuals(x: Values) -> Values:
        asked.append(x)
        return np.array([1e3 * np.cos(x[0]), x[0]])

    least_squares(
        residuals, lambda x: np.array([[-1e3 * np.sin(x[0])], [1.0]]), np.ones(1), evaluations=4
    )
    assert len(asked) <= 4


def test_value_without_influence_stays() -> None:
    found = least_squares(
        lambda x: np.array([x[0] - 2.0]), lambda _: np.array([[1.0, 0.0]]), np.array([0.0, 7.0])
    )
    np.testing.assert_allclose(found.values, [2.0, 7.0], atol=1e-6)


def test_exception_of_an_evaluation_ends_the_solver() -> None:
    def cancelled(_: Values) -> Values:
        raise RuntimeError

    with pytest.raises(RuntimeError):
        least_squares(cancelled, lambda _: np.eye(1), np.zeros(1))
