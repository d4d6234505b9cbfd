"""Parts put one after another, whatever library, type and layout they are of."""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

from veilcam_optics.transfer.gradients import Joined
from veilcam_optics.transfer.joining import joined

Values = npt.NDArray[Any]


@pytest.mark.parametrize("library", [np.asarray, torch.tensor])
@pytest.mark.parametrize("lengths", [(3,), (0,), (2, 2, 1), (1, 4)])
def test_parts_are_joined_in_their_order(lengths: tuple[int, ...], library: Any) -> None:
    whole = np.arange(4.0 * sum(lengths)).reshape(-1, 4)
    ends = np.cumsum((0, *lengths))
    parts = [library(whole[start:end]) for start, end in itertools.pairwise(ends)]
    found = joined((part for part in parts), sum(lengths))
    assert type(found) is type(parts[0])
    assert np.array_equal(np.asarray(found), whole)


@pytest.mark.parametrize("columns", [1, 2, 3, 4, 8])
@pytest.mark.parametrize("kind", ["float32", "float64"])
@pytest.mark.parametrize("library", [np.asarray, torch.from_numpy])
def test_rows_of_any_width_are_moved_as_they_are(library: Any, kind: str, columns: int) -> None:
    """Whole words of 16 bytes or not, with axes exchanged, and from the middle of an array."""
    whole = np.arange(2 * 3 * 4 * (columns + 1), dtype=kind).reshape(3, 4, 2, columns + 1)
    whole.flat[5] = np.nan
    for start in (0, 1):
        wanted = whole[..., start : start + columns].transpose(2, 0, 1, 3)
        given = library(whole)[..., start : start + columns]
        parts = [given[:, :, k : k + 1].swapaxes(0, 2).swapaxes(1, 2) for k in (0, 1)]
        found = joined(parts, 2)
        assert np.array_equal(np.asarray(found), wanted, equal_nan=True)
        assert np.asarray(found).flags.c_contiguous


def test_gradient_finds_its_way_to_every_part() -> None:
    parts = [torch.full((2, 3), float(k), requires_grad=True) for k in range(3)]
    found = Joined.apply(6, *parts)  # type: ignore[no-untyped-call]
    found.backward(torch.arange(18.0).reshape(6, 3))
    assert torch.equal(found[2:4], parts[1])
    gradients = [part.grad for part in parts if part.grad is not None]
    assert torch.equal(torch.cat(gradients), torch.arange(18.0).reshape(6, 3))


def test_only_one_part_is_held_at_a_time() -> None:
    """But for the first: without a gradient, each is let go once it is in its place."""
    held: list[weakref.ref[Values]] = []

    def parts() -> Iterator[Values]:
        for _ in range(4):
            assert sum(each() is not None for each in held) <= 1 + (len(held) > 1)
            part = np.ones((2, 3))
            held.append(weakref.ref(part))
            yield part

    assert joined(parts(), 8).all()
    assert len(held) == 4
