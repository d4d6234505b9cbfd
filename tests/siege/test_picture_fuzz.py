"""The fuzzing of pictures, made short; and that it would notice a failure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.pictures.doors import open_doors
from tests.pictures.samples import make_samples
from tests.siege.picture_fuzz import fault_of, mutated, try_all

READABLE = tuple(sample for sample in make_samples() if not sample.refusal)


@pytest.mark.slow
def test_mutated_pictures_are_refused_by_name_or_read(tmp_path: Path) -> None:
    with open_doors(tmp_path) as doors:
        outcomes, failures = try_all(doors, 100, READABLE)
    assert failures == []
    assert min(outcomes["read"], outcomes["refused"]) > 30


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
