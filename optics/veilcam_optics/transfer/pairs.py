"""Interfering pairs of sub-pixels, and the tables that they are stacked into."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic

from veilcam_optics.arrays import Array, namespace
from veilcam_optics.transfer.kernels import Axis
from veilcam_optics.transfer.product import Measurement, Stack


@dataclass(frozen=True, slots=True)
class Group(Generic[Array]):
    """Sub-pixel pairs of one beam that share a column offset, hence a column kernel."""

    first: Array
    """Rows of the pairs' sub-pixels, (pairs,)."""
    second: Array
    """Rows of those ``offset`` columns to the right, (pairs,)."""
    offset: int
    columns: Array
    """Kernel along x, (column pairs, offsets x)."""
    rows: Array
    """Kernels along y, (offsets y, pairs)."""

    @property
    def shape(self) -> tuple[int, int]:
        """Column offset and number of row pairs: groups that have both alike are stacked."""
        return self.offset, self.first.shape[0]


def dark(y: Axis[Array], x: Axis[Array]) -> Group[Array]:
    """Return a group without pairs."""
    xp = namespace(y.offsets)
    none = xp.zeros(0, dtype=xp.int64)
    columns = xp.zeros((x.centres.shape[0], x.offsets.shape[0]), dtype=xp.float64)
    return Group(none, none, 0, columns, xp.zeros((y.offsets.shape[0], 0), dtype=xp.float64))


def stack_groups(
    groups: Sequence[Group[Array]], window: tuple[int, int], dtype: Any
) -> Measurement[Array]:
    """One measurement's groups, at least one, stacked where they are of one shape.

    Args:
        groups: groups of pairs of a mask of the shape ``window``.
        window: rows and columns.
        dtype: type of the tables.
    """
    xp = namespace(groups[0].rows)
    by_shape: dict[tuple[int, int], list[Group[Array]]] = {}
    for group in groups:
        by_shape.setdefault(group.shape, []).append(group)
    stacks = tuple(
        Stack.of(
            first=xp.concat([group.first for group in alike]),
            second=xp.concat([group.second for group in alike]),
            columns=xp.astype(xp.stack([group.columns for group in alike]), dtype),
            window=window,
        )
        for alike in by_shape.values()
    )
    rows = [group.rows for alike in by_shape.values() for group in alike]
    return Measurement(stacks, xp.astype(xp.concat(rows, axis=1), dtype))
