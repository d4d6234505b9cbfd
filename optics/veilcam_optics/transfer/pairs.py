"""Interfering pairs of sub-pixels, and the products of matrices that add up their light.

Pairs as many columns apart share a kernel along x. Such groups are stacked where they are of one
shape, whatever their colour, wavelength or rows: all of them, and all masks, are spread along x by
one product, and gathered along y by another.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from veilcam_optics.transfer.kernels import Axis


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


class _Stack(nn.Module):
    """Groups of one shape, spread along x by a single product of matrices."""

    first: Tensor
    second: Tensor
    columns: Tensor

    def __init__(self, groups: Sequence[Group]) -> None:
        super().__init__()
        self.offset, self.pairs = groups[0].shape
        alone = (torch.equal(group.first, group.second) for group in groups)
        self._alone = self.offset == 0 and all(alone)
        self.register_buffer("first", torch.cat([group.first for group in groups]))
        self.register_buffer("second", torch.cat([group.second for group in groups]))
        self.register_buffer("columns", torch.stack([group.columns for group in groups]))

    def spread(self, weights: Tensor, x: slice) -> Tensor:
        """Products of paired weights, spread along x.

        Args:
            weights: of one mask, (rows, columns), or of several, (rows, masks, columns).
            x: offsets that are wanted.

        Returns:
            (row pairs, offsets ``x``), or (row pairs, masks * offsets ``x``).
        """
        columns = self.columns[..., x]
        one = weights.index_select(0, self.first)
        if self._alone:
            products = one.square()
        else:
            other = weights.index_select(0, self.second)[..., self.offset :]
            products = one[..., : columns.shape[1]] * other
        # A mask more is so many rows more of the same products: nothing is laid out anew.
        masks = weights.shape[1:-1].numel()
        stacked = products.reshape(len(columns), self.pairs * masks, columns.shape[1])
        return (stacked @ columns).reshape(len(self.first), masks * columns.shape[2])


class Measurement(nn.Module):
    """What one output (gray, or one colour) adds up: stacked groups and their row kernels."""

    rows: Tensor

    def __init__(self, groups: Sequence[Group], dtype: torch.dtype) -> None:
        super().__init__()
        by_shape: dict[tuple[int, int], list[Group]] = {}
        for group in groups:
            by_shape.setdefault(group.shape, []).append(group)
        # Held twice: a ModuleList does not tell the type of what it holds.
        self._stacks = tuple(_Stack(alike) for alike in by_shape.values())
        self.stacks = nn.ModuleList(self._stacks)
        rows = [group.rows for alike in by_shape.values() for group in alike]
        self.register_buffer("rows", torch.cat(rows, dim=1))
        self.to(dtype)

    def embed(self, scenes: Tensor, weights: Tensor, pixels: tuple[int, int]) -> Tensor:
        """Embeddings (batch, *pixels) of scenes (batch, rows, columns), without the transfer."""
        if not len(scenes):
            return scenes.new_zeros(0, *pixels)
        height, width = scenes.shape[1:]
        pairs = self.rows.shape[1]
        down = self.rows.reshape(height, pixels[0], pairs).permute(1, 2, 0).flatten(1)
        spread = self._spread(weights, slice(None)).reshape(pairs, width, pixels[1])
        # One scene at a time holds only (pairs, rows, pixel columns) at once.
        return torch.stack([down @ (scene @ spread).flatten(0, 1) for scene in scenes])

    def transfer(self, weights: Tensor, y: slice, x: slice) -> Tensor:
        """Transfer of a mask (rows, columns), as (offsets ``y``, offsets ``x``).

        Of masks (rows, masks, columns) it is (offsets ``y``, masks * offsets ``x``).
        """
        return self.rows[y] @ self._spread(weights, x)

    def _spread(self, weights: Tensor, x: slice) -> Tensor:
        """All row pairs, spread along x: (pairs, offsets ``x``), or (pairs, masks * offsets)."""
        values = [stack.spread(weights, x) for stack in self._stacks]
        return values[0] if len(values) == 1 else torch.cat(values)
