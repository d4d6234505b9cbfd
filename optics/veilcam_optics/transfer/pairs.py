"""Interfering pairs of sub-pixels, and the tables that they are stacked into."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from veilcam_optics.transfer.kernels import Axis
from veilcam_optics.transfer.product import Measurement, Stack


@dataclass(frozen=True, slots=True)
class Group:
    """Sub-pixel pairs of one beam that share a column offset, hence a column kernel."""

    first: Tensor
    """Rows of the pairs' sub-pixels, (pairs,)."""
    second: Tensor
    """Rows of those ``offset`` columns to the right, (pairs,)."""
    offset: int
    columns: Tensor
    """Kernel along x, (column pairs, offsets x)."""
    rows: Tensor
    """Kernels along y, (offsets y, pairs)."""

    @property
    def shape(self) -> tuple[int, int]:
        """Column offset and number of row pairs: groups that have both alike are stacked."""
        return self.offset, len(self.first)


def dark(y: Axis, x: Axis) -> Group:
    """A group without pairs."""
    none = torch.zeros(0, dtype=torch.long)
    columns = torch.zeros(len(x.centres), len(x.offsets), dtype=torch.float64)
    return Group(none, none, 0, columns, torch.zeros(len(y.offsets), 0, dtype=torch.float64))


def stack_groups(
    groups: Sequence[Group], window: tuple[int, int], dtype: torch.dtype
) -> Measurement[Tensor]:
    """One measurement's groups, at least one, stacked where they are of one shape.

    Args:
        groups: of a mask of the shape ``window``.
        window: rows and columns.
        dtype: of the tables.
    """
    by_shape: dict[tuple[int, int], list[Group]] = {}
    for group in groups:
        by_shape.setdefault(group.shape, []).append(group)
    stacks = tuple(
        Stack.of(
            first=torch.cat([group.first for group in alike]),
            second=torch.cat([group.second for group in alike]),
            columns=torch.stack([group.columns for group in alike]).to(dtype),
            window=window,
        )
        for alike in by_shape.values()
    )
    rows = [group.rows for alike in by_shape.values() for group in alike]
    return Measurement(stacks, torch.cat(rows, dim=1).to(dtype))
