"""Transfer matrices from tables of kernels, by pure functions of arrays.

The tables are made once, from camera, scene and embedding, by
:class:`~veilcam_optics.transfer.operator.TransferOperator`. What they are multiplied by here is the
mask: in NumPy on the device; in torch, with gradients, in training.

Pairs as many columns apart share a kernel along x. Such groups of pairs are stacked where they are
of one shape, whatever their colour, wavelength or rows: all of them, and all masks, are spread
along x by one product, and gathered along y by another.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, Self

from veilcam_optics.arrays import Array, device, namespace, needs_gradient
from veilcam_optics.camera.geometry import CHANNELS, Camera, Embedding, Scene
from veilcam_optics.camera.inputs import check_scenes, check_weights
from veilcam_optics.transfer.joining import joined
from veilcam_optics.transfer.regions import Region, embed_lit

_NUMBERS_AT_ONCE = 2**20
"""Of all masks that one product takes: more of them do not fit in a processor's cache."""

_TABLES = ("first", "second", "columns")
"""Of a stack, as files and buffers name them."""


@dataclass(frozen=True, slots=True)
class Stack(Generic[Array]):
    """Groups of sub-pixel pairs, each as many and as many columns apart."""

    first: Array
    """Rows of the pairs' sub-pixels, (groups * pairs,), integers."""
    second: Array
    """Rows of those ``offset`` columns to the right."""
    columns: Array
    """Kernels along x, (groups, column pairs, offsets x)."""
    offset: int
    squares: bool
    """Every sub-pixel is paired with itself."""

    @classmethod
    def of(cls, first: Array, second: Array, columns: Array, window: tuple[int, int]) -> Self:
        """Make a stack from tables alone: pairs some columns apart are as many columns fewer."""
        offset = window[1] - columns.shape[1]
        squares = offset == 0 and bool(namespace(first).all(first == second))
        return cls(first, second, columns, offset, squares)

    def spread(self, weights: Array, x: slice) -> Array:
        """Products of paired weights, spread along x.

        Args:
            weights: weights of one mask, (rows, columns), or of several, (rows, masks, columns).
            x: offsets that are wanted.

        Returns:
            (row pairs, offsets ``x``), or (row pairs, masks * offsets ``x``).
        """
        columns = self.columns[..., x]
        groups, across, offsets = columns.shape
        pairs = self.first.shape[0]
        masks = weights.shape[1] if weights.ndim == 3 else 1
        one = weights[self.first]
        if self.squares:
            products = one * one
        else:
            products = one[..., :across] * weights[self.second][..., self.offset :]
        # A mask more is so many rows more of the same products: nothing is laid out anew.
        stacked = products.reshape((groups, pairs // groups * masks, across))
        spread: Array = (stacked @ columns).reshape((pairs, masks * offsets))
        return spread


@dataclass(frozen=True, slots=True)
class Measurement(Generic[Array]):
    """Terms of one output (gray, or one colour): stacked groups and their row kernels."""

    stacks: tuple[Stack[Array], ...]
    rows: Array
    """Kernels along y, (offsets y, pairs), in the order of the stacks."""

    def transfer(self, weights: Array, y: slice, x: slice) -> Array:
        """Transfer of a mask (rows, columns), as (offsets ``y``, offsets ``x``).

        Of masks (rows, masks, columns) it is (offsets ``y``, masks * offsets ``x``).
        """
        transfer: Array = self.rows[y] @ self._spread(weights, x)
        return transfer

    def embed(self, scenes: Array, weights: Array, pixels: tuple[int, int]) -> Array:
        """Embeddings (batch, *pixels) of scenes (batch, rows, columns), without the transfer."""
        xp = namespace(scenes)
        height, width = scenes.shape[1:]
        found: Array
        if not scenes.shape[0]:
            found = xp.zeros((0, *pixels), dtype=scenes.dtype, device=device(scenes))
            return found
        pairs = self.rows.shape[1]
        by_pixel = xp.reshape(self.rows, (height, pixels[0], pairs))
        down = xp.reshape(xp.permute_dims(by_pixel, (1, 2, 0)), (pixels[0], -1))
        spread = xp.reshape(self._spread(weights, slice(None)), (pairs, width, pixels[1]))
        # One scene at a time holds only (pairs, rows, pixel columns) at once.
        found = xp.stack(
            [
                down @ xp.reshape(scenes[index] @ spread, (-1, pixels[1]))
                for index in range(scenes.shape[0])
            ]
        )
        return found

    def _spread(self, weights: Array, x: slice) -> Array:
        """All row pairs, spread along x: (pairs, offsets ``x``), or (pairs, masks * offsets)."""
        values = [stack.spread(weights, x) for stack in self.stacks]
        if len(values) == 1:
            return values[0]
        together: Array = namespace(weights).concat(values)
        return together


@dataclass(frozen=True, slots=True)
class Transfer(Generic[Array]):
    """``T(w)`` of one camera, scene and embedding, as a function of the mask's weights alone.

    All methods are pure: they change nothing, and give arrays of the library that the mask, the
    scenes and the tables are of.
    """

    camera: Camera
    scene: Scene
    embedding: Embedding
    measurements: tuple[Measurement[Array], ...] = field(repr=False)
    """One that is gray, or one each for R, G and B."""
    fade: Array = field(repr=False)
    """Share of the light that each scene pixel keeps over the field, (rows, columns)."""

    @property
    def colour(self) -> bool:
        """True where the three channels are kept apart."""
        return len(self.measurements) == len(CHANNELS)

    @property
    def dtype(self) -> Any:
        """Type of every result."""
        return self.measurements[0].rows.dtype

    def __call__(self, weights: Array, region: Region | None = None) -> Array:
        """Return the transfer matrix of a mask, or of each of several.

        Args:
            weights: amplitude transmittances, ``camera.mask_shape``, or (masks, rows, columns).
                Several masks at once save what a call costs beside its products, which is most of
                it where scene and embedding are small.
            region: part of the scene that is asked for; None for all of it. Its cost is its own: an
                object that moves about in a large and black scene costs what the object does.

        Returns:
            (scene pixels, embedding pixels), or (3, scene pixels, embedding pixels) in colour, for
            each mask: irradiance of an embedding pixel relative to an all-white scene seen without
            a mask.

        Raises:
            OpticsError: the masks have another shape, or hold NaN or infinity; a region that is not
                wholly in the scene.
        """
        batched = weights.ndim == 3
        check_weights(weights, self.camera, batched=batched)
        if region is None:
            region = Region(0, 0, *self.scene.shape)
        else:
            region.check(self.scene)
        if not batched:
            transfers = [self._one(each, weights, region) for each in self.measurements]
        else:
            transfers = [self._several(each, weights, region) for each in self.measurements]
        if not self.colour:  # taken as it is: stacking would copy the largest array of a step
            return transfers[0]
        stacked: Array = namespace(weights).stack(transfers, axis=-3)
        return stacked

    def embed(self, scenes: Array, weights: Array) -> Array:
        """Noiseless embeddings of scenes behind a mask.

        Args:
            scenes: (batch, rows, columns), or (batch, 3, rows, columns) in colour, in [0, 1].
            weights: amplitude transmittances, ``camera.mask_shape``.

        Returns:
            (batch, rows, columns) or (batch, 3, rows, columns) of the embedding.

        Raises:
            OpticsError: the scenes or the mask have another shape.
        """
        self._check_scenes(scenes)
        xp = namespace(scenes)
        values: Array
        shape: tuple[int, ...] = (scenes.shape[0], *self.embedding.shape)
        if self.colour:
            shape = (scenes.shape[0], len(CHANNELS), *self.embedding.shape)
            flat = xp.reshape(scenes, (*shape[:2], self.scene.rows * self.scene.columns))
            by_channel = xp.permute_dims(flat, (1, 0, 2)) @ self(weights)
            values = xp.permute_dims(by_channel, (1, 0, 2))
        else:
            whole = Region(0, 0, *self.scene.shape)
            values = embed_lit(scenes, whole, lambda region: self(weights, region))
        embeddings: Array = xp.reshape(values, shape)
        return embeddings

    def embed_by_factors(self, scenes: Array, weights: Array) -> Array:
        """As :meth:`embed`, factor by factor: for matrices too large to be formed.

        It needs ``pairs x rows x columns`` numbers at once, and more time for each scene.
        """
        self._check_scenes(scenes)
        check_weights(weights, self.camera)
        scenes = scenes * self.fade
        values = [
            measurement.embed(
                scenes[:, channel] if self.colour else scenes, weights, self.embedding.shape
            )
            for channel, measurement in enumerate(self.measurements)
        ]
        if not self.colour:
            return values[0]
        stacked: Array = namespace(scenes).stack(values, axis=1)
        return stacked

    def arrays(self) -> dict[str, Array]:
        """All tables by name: what a file holds, or a module of torch as its buffers."""
        named: dict[str, Array] = {"fade": self.fade}
        for channel, measurement in enumerate(self.measurements):
            named[f"rows_{channel}"] = measurement.rows
            for index, stack in enumerate(measurement.stacks):
                for name in _TABLES:
                    named[f"{name}_{channel}_{index}"] = getattr(stack, name)
        return named

    @classmethod
    def from_arrays(
        cls, camera: Camera, scene: Scene, embedding: Embedding, arrays: Mapping[str, Array]
    ) -> Self:
        """Make a transfer from :meth:`arrays`, also of another type, library or place."""
        measurements = []
        for channel in range(len(CHANNELS)):
            if f"rows_{channel}" not in arrays:
                break
            stacks: list[Stack[Array]] = []
            while f"columns_{channel}_{len(stacks)}" in arrays:
                first, second, columns = (
                    arrays[f"{table}_{channel}_{len(stacks)}"] for table in _TABLES
                )
                stacks.append(Stack.of(first, second, columns, camera.mask_shape))
            measurements.append(Measurement(tuple(stacks), arrays[f"rows_{channel}"]))
        return cls(camera, scene, embedding, tuple(measurements), arrays["fade"])

    def _one(self, measurement: Measurement[Array], weights: Array, region: Region) -> Array:
        """Transfer (scene pixels, embedding pixels) of one mask."""
        rows, columns = self.embedding.shape
        transfer = measurement.transfer(weights, *self._offsets(region))
        xp = namespace(weights)
        apart = xp.reshape(transfer, (region.rows, rows, region.columns, columns))
        matrix: Array = xp.reshape(
            xp.permute_dims(apart, (0, 2, 1, 3)), (region.rows * region.columns, rows * columns)
        )
        matrix *= self._fade(region)
        return matrix

    def _several(self, measurement: Measurement[Array], weights: Array, region: Region) -> Array:
        """Transfers (masks, scene pixels, embedding pixels)."""
        xp = namespace(weights)
        pixels, masks = region.rows * region.columns, weights.shape[0]
        at_once = max(1, _NUMBERS_AT_ONCE // (pixels * self.embedding.size))
        starts = range(0, max(1, masks), at_once)
        parts = (
            self._apart(measurement, weights[start : start + at_once], region) for start in starts
        )
        first = next(parts)
        together: Array
        if needs_gradient(first):
            from veilcam_optics.transfer.gradients import Joined  # noqa: PLC0415 - torch is here

            together = Joined.apply(masks, first, *parts)  # type: ignore[no-untyped-call]
        else:
            together = joined(itertools.chain([first], parts), masks)
        # Laid out in the order of pixels by what joins them.
        matrices: Array = xp.reshape(together, (masks, pixels, self.embedding.size))
        faded: Array = matrices * self._fade(region)
        return faded

    def _apart(self, measurement: Measurement[Array], weights: Array, region: Region) -> Array:
        """Transfers (masks, scene rows, columns, embedding rows, columns), as they come."""
        xp = namespace(weights)
        rows, columns = self.embedding.shape
        transfer = measurement.transfer(xp.permute_dims(weights, (1, 0, 2)), *self._offsets(region))
        shape = (region.rows, rows, weights.shape[0], region.columns, columns)
        apart: Array = xp.permute_dims(xp.reshape(transfer, shape), (2, 0, 3, 1, 4))
        return apart

    def _fade(self, region: Region) -> Array:
        """Shares of the light that the scene pixels of a region keep, (scene pixels, 1)."""
        rows = slice(region.top, region.top + region.rows)
        columns = slice(region.left, region.left + region.columns)
        fade: Array = namespace(self.fade).reshape(self.fade[rows, columns], (-1, 1))
        return fade

    def _offsets(self, region: Region) -> tuple[slice, slice]:
        """Offsets along y and x of a region: as its pixels are in order, they lie side by side."""
        rows, columns = self.embedding.shape
        return (
            slice(region.top * rows, (region.top + region.rows) * rows),
            slice(region.left * columns, (region.left + region.columns) * columns),
        )

    def _check_scenes(self, scenes: Array) -> None:
        expected = (len(CHANNELS), *self.scene.shape) if self.colour else self.scene.shape
        check_scenes(scenes, "batch", *expected)
