"""The fuzzing of pictures would notice a failure."""

from __future__ import annotations

import numpy as np
import pytest
from tests.pictures.samples import make_samples
from tests.siege.picture_fuzz import fault_of, holds, mutated

READABLE = [sample for sample in make_samples() if not sample.refusal]


def test_seed_gives_the_same_picture_again() -> None:
    assert [mutated(seed, READABLE) for seed in range(50)] == [
        mutated(seed, READABLE) for seed in range(50)
    ]


@pytest.mark.parametrize(
    "found",
    ["UNNAMED 500 internal", "two\nlines", "", np.full((2, 2), np.nan), np.full((2, 2), 7.0)],
)
def test_harm_is_noticed(found: object) -> None:
    assert fault_of(found) is not None


def test_picture_that_is_read_as_another_or_refused_holds_not() -> None:
    gray = READABLE[0]
    assert not holds(gray, "it is damaged")
    assert not holds(gray, np.zeros((32, 32)))
