"""Arrays put one after another, in memory that is new: what many masks' transfers are made into."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator

import numpy as np

from veilcam_optics.arrays import Array, as_numpy, is_torch_array, namespace

_WORD = 16
"""Bytes of the largest number that NumPy and torch both know."""


def joined(parts: Iterable[Array], length: int) -> Array:
    """Arrays, at least one, one after another along their first axis; contiguous, in memory new.

    Each is written to its place as soon as it is made, so that no second copy of them all is ever
    held: memory that is new costs more time than what is written into it. Without gradients; see
    :class:`~veilcam_optics.transfer.gradients.Joined`.

    Args:
        parts: arrays of one type and shape, but for the length of the first axis.
        length: length of all first axes together.
    """
    rest: Iterator[Array] = iter(parts)
    first: Array = next(rest)
    together = _new((length, *first.shape[1:]), first)
    start = 0
    for part in itertools.chain([first], rest):
        stop = start + part.shape[0]
        place, values = _in_words(together[start:stop], part)
        place[...] = values
        start = stop
    return together


def _new(shape: tuple[int, ...], like: Array) -> Array:
    """Memory for an array of the type and library of another, where that one is.

    Linux hands out new memory a page at a time, which takes longer than to fill it. NumPy asks for
    pages of 2 MB where an array is large; torch does not, so on a processor its memory is NumPy's.
    """
    if not is_torch_array(like):
        return np.empty(shape, like.dtype)
    import torch  # noqa: PLC0415 - an array of torch is here, so torch is

    if like.device.type != "cpu":
        return like.new_empty(shape)
    return torch.from_numpy(np.empty(shape, as_numpy(like[:0]).dtype))


def _in_words(*arrays: Array) -> tuple[Array, ...]:
    """View the same memory in words of 16 bytes, where rows are whole words.

    Rows of few numbers, moved about, are copied a number at a time: in words, three times as fast.
    """
    count = _WORD // arrays[0].itemsize
    if not all(_whole(array, count) for array in arrays):
        return arrays
    return tuple(array.view(namespace(array).complex128) for array in arrays)


def _whole(array: Array, count: int) -> bool:
    """Return whether rows lie in memory as words of so many numbers."""
    if is_torch_array(array):
        places = [array.storage_offset(), *array.stride()]
    else:
        places = [stride // array.itemsize for stride in array.strides]
    *others, last = places
    return (
        last == 1 and array.shape[-1] % count == 0 and all(other % count == 0 for other in others)
    )
