"""A cheap look at transfer matrices: a few random masks, a few entries, in float64.

What an approximation costs in accuracy is measured on these, relative L2, for masks of independent
uniform weights. A transfer matrix has one entry for each offset along y and each along x; some of
them, evenly spread, stand for all. All that weighs an entry before it is judged counts: its scene
pixel fades, its embedding pixel has a share of each colour, and light is scattered.

For one entry the light is wanted on two boxes alone, and there the fields of all apertures are
known: with ``K[r, s]`` the integral of ``kappa F_r conj(F_s)``, an entry is the sum over
``K_y[r, s] K_x[c, d] w[r, c] w[s, d]``, of near pairs and of far ones.

Of a large window the middle stands for all: sub-pixels farther away are taken for closed.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Self

import numpy as np
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Scene, Window
from veilcam_optics.effects.composition import beams, collected, shown
from veilcam_optics.effects.light import fade, scene_pixel_tangent, tangents
from veilcam_optics.effects.model import Model
from veilcam_optics.effects.sensor import channel_shares, mean_shares
from veilcam_optics.transfer.entries import Values, integrals, within_reach
from veilcam_optics.transfer.kernels import Axis
from veilcam_optics.transfer.tables import Beam, make_axes

_OFFSETS = 12
"""Offsets kept of each axis."""

_MANY = 200
"""Weights of a mask whose light is about alike everywhere: two thirds of the offsets will do."""

_WEIGHTS = 4000
"""Random weights in all masks together, and hence how well chance averages out."""

_MOST_LINES = 48
"""Rows, and columns, of the middle of a window that are looked at."""


class Probe:
    """Masks and offsets at which models are compared.

    Args:
        model: gives camera, scene and embedding; all compared models share their shapes.
        offsets: offsets kept of each axis.
        whole: another of the model, with more: these are among its own, and what it has integrated
            is not integrated again.
    """

    def __init__(self, model: Model, offsets: int = _OFFSETS, whole: Self | None = None) -> None:
        lines, model = model.camera.mask_shape, cropped(model)
        rows, columns = model.camera.mask_shape
        count = min(16, max(2, math.ceil(_WEIGHTS / (rows * columns))))
        generator = torch.Generator().manual_seed(0)
        self.masks = torch.rand(count, rows, columns, generator=generator, dtype=torch.float64)
        offsets = offsets if rows * columns < _MANY else offsets * 2 // 3
        self._kept: dict[object, tuple[int, Values | None]] = {}
        self._axes: dict[object, tuple[Axis[Values], Axis[Values]]] = {}
        kept = (None, None) if whole is None else (whole.kept_y, whole.kept_x)
        self.kept_y: Tensor
        self.kept_x: Tensor
        self.kept_y, self._together_y = _spread(model, lines[0], 0, offsets, kept[0])
        self.kept_x, self._together_x = _spread(model, lines[1], 1, offsets, kept[1])
        self._whole = whole
        self._places = [
            np.arange(len(own)) if some is None else (own[:, None] == some).nonzero()[:, 1].numpy()
            for own, some in zip((self.kept_y, self.kept_x), kept, strict=True)
        ]

    def axes(self, model: Model, beam: Beam, parts: int = 1) -> tuple[Axis[Values], Axis[Values]]:
        """Return the axes of ``model``, cropped, reduced to the kept offsets.

        Args:
            model: like the probe's.
            beam: may come from another distance.
            parts: number of parts of every scene pixel along each axis, with an offset each.
        """
        scene = model.scene
        if beam.scene_distance is not None:
            scene = replace(scene, distance=beam.scene_distance)
        key = (model.camera, scene, model.conditions.imperfections, model.approximation, parts)
        if key not in self._axes:
            self._axes[key] = self._made_axes(model, scene, parts)
        return self._axes[key]

    def _made_axes(
        self, model: Model, scene: Scene, parts: int
    ) -> tuple[Axis[Values], Axis[Values]]:
        model = cropped(model)
        y, x = make_axes(
            model.camera,
            scene,
            model.embedding,
            step=model.sampling.step,
            approximation=model.approximation,
            imperfections=model.conditions.imperfections,
            like=np.empty(0),
        )
        found = []
        for axis, kept in ((y, self.kept_y), (x, self.kept_x)):
            some = axis.at(kept.numpy())
            tangent = scene_pixel_tangent(model)
            some.offsets = _parted(some.offsets, float(axis.image), parts)
            some.tangents = _parted(some.tangents, tangent, parts)
            some.image, some.scale = axis.image / parts, axis.scale * parts
            found.append(some)
        return found[0], found[1]

    def tangents(self, model: Model, parts: int = 1) -> tuple[Tensor, Tensor]:
        """Tangents of the angles to the axis of what kept offsets see, along y and x."""
        y, x = tangents(model)
        embedding = model.embedding
        y, x = y[self.kept_y // embedding.rows], x[self.kept_x // embedding.columns]
        side = scene_pixel_tangent(model)
        return tuple(  # type: ignore[return-value]
            torch.from_numpy(_parted(each.numpy(), side, parts)) for each in (y, x)
        )

    def channels(self, model: Model) -> list[int]:
        """Channels that count in a gray measurement, brightest first; at least one."""
        shares = mean_shares(model)
        light = [
            share * sum(amplitude**2 for amplitude in model.camera.row_amplitudes(channel))
            for channel, share in enumerate(shares)
        ]
        order = sorted(range(len(light)), key=lambda channel: -light[channel])
        return [channel for channel in order if light[channel]] or order[:1]

    def transfer(
        self,
        model: Model,
        stretch: tuple[float, float] = (1.0, 1.0),
        *,
        channels: Sequence[int] | None = None,
    ) -> Tensor:
        """Gray transfer of every mask at the kept offsets, (masks, offsets y, offsets x).

        Rotation and what the sensor makes of linear light are left out.
        """
        return self.faded(model, self.light(model, stretch, channels=channels))

    def light(
        self,
        model: Model,
        stretch: tuple[float, float] = (1.0, 1.0),
        *,
        channels: Sequence[int] | None = None,
        parts: int = 1,
    ) -> Tensor:
        """As :meth:`transfer`, before light fades over the field and is scattered.

        With ``parts``, that of each of so many parts of scene pixels along each axis.
        """
        total = self.dark(parts)
        for beam, scaled in self.lights(model, channels):
            rows, down, across = self._pairs(model, beam, stretch, parts)
            weights = scaled[:, rows]
            seen = pair_sums(down, across, weights, weights)
            total += self.share(model, beam.channel, parts) * seen
        return total

    def share(self, model: Model, channel: int, parts: int = 1) -> float | Tensor:
        """Return a channel's share of the reading: alike everywhere, or (offsets y, offsets x)."""
        if not model.conditions.bayer:
            return model.camera.sensor.channel_weights[channel]
        rows, columns = model.embedding.shape
        shares = channel_shares(model)[channel][self.kept_y % rows][:, self.kept_x % columns]
        return shares.repeat_interleave(parts, 0).repeat_interleave(parts, 1)

    def faded(self, model: Model, light: Tensor) -> Tensor:
        """Return the light at the kept offsets after fading, (..., offsets y, offsets x)."""
        rows, columns = model.embedding.shape
        return (
            self.scattered(model, light)
            * fade(model)[self.kept_y // rows][:, self.kept_x // columns]
        )

    def scattered(self, model: Model, light: Tensor) -> Tensor:
        """Light at the kept offsets, (..., offsets y, offsets x), after its way to the sensor.

        A scene pixel's light is scattered over its own embedding pixels. Where these are too many
        to be kept, the mean over all that is kept stands for them: it tells light from even light
        all the more.
        """
        shape = (-1, self._together_y, light.shape[-1] // self._together_x, self._together_x)
        apart = light.reshape(*light.shape[:-2], *shape)
        return collected(model, apart, (-3, -1)).reshape(light.shape)

    def within(self, model: Model, rows: Sequence[int], columns: Sequence[int]) -> Tensor:
        """Return the transfer with pairs at most so many rows and so many columns apart.

        Args:
            model: model whose own reach is the farthest.
            rows: reaches along y.
            columns: reaches along x.

        Returns:
            (len(rows), len(columns), masks, offsets y, offsets x).
        """
        found = self.dark().repeat(len(rows), len(columns), 1, 1, 1)
        for beam, scaled in self.lights(model):
            used, down, across = self._pairs(model, beam, (1.0, 1.0))
            weights, share = scaled[:, used], self.share(model, beam.channel)
            close = [down * _near(used, far) for far in rows]
            for k, far in enumerate(columns):
                near = across * _near(torch.arange(across.shape[-1]), far)
                spread = pair_products(near, weights, weights)
                for n, one in enumerate(close):
                    found[n, k] += share * _traced(one, spread)
        return self.faded(model, found)

    def dark(self, parts: int = 1) -> Tensor:
        """No light at any kept offset behind any mask, (masks, offsets y, offsets x)."""
        shape = (len(self.masks), parts * len(self.kept_y), parts * len(self.kept_x))
        return torch.zeros(shape, dtype=torch.float64)

    def lights(
        self, model: Model, channels: Sequence[int] | None = None
    ) -> list[tuple[Beam, Tensor]]:
        """Each beam with the amplitudes that it passes, its share of the channel included."""
        used = self.channels(model) if channels is None else channels
        model = cropped(model)
        weights, found = shown(model, self.masks), []
        for beam in beams(model):
            if beam.channel in used:
                passed = torch.tensor(
                    model.camera.row_amplitudes(beam.channel), dtype=torch.float64
                )
                found.append((beam, weights * (passed * math.sqrt(beam.share))[:, None]))
        return found

    def _pairs(
        self,
        model: Model,
        beam: Beam,
        stretch: tuple[float, float],
        parts: int = 1,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Rows that pass light, and ``K`` along y and x; kept, since masks do not change them."""
        axes = self.axes(model, beam, parts)
        used = (lit_rows(model, beam.channel), np.arange(len(axes[1].centres)))
        reach = model.sampling.reach
        found = []
        for index, (axis, some, far) in enumerate(
            zip(axes, used, (reach.rows, reach.columns), strict=True)
        ):
            wavelength = float(beam.wavelength) * stretch[index]
            key = (
                *(index, axis.centres[0], axis.centres[-1], axis.width, axis.distance),
                *(axis.source_distance, axis.image, axis.pixel, some.tobytes(), wavelength),
                *(model.approximation, model.scene, parts),
            )
            kept, values = self.integrated(key, index)
            if values is None or kept < far:
                kept, values = far, integrals(axis, some, wavelength, far)
                self._kept[key] = kept, values
            near = values if kept == far else values * within_reach(some, far)
            found.append(torch.from_numpy(near))
        return torch.from_numpy(used[0]), found[0], found[1]

    def integrated(self, key: object, index: int) -> tuple[int, Values | None]:
        """Return the reach of known integrals along an axis, and the integrals."""
        if key not in self._kept and self._whole is not None:
            far, values = self._whole.integrated(key, index)
            if values is not None:
                self._kept[key] = far, values[self._places[index]]
        return self._kept.get(key, (-1, None))


def lit_rows(model: Model, channel: int) -> Values:
    """Return the indices of the rows, of a cropped window, whose filters pass a channel's light."""
    return np.flatnonzero(cropped(model).camera.row_amplitudes(channel))


@lru_cache(maxsize=64)
def cropped(model: Model) -> Model:
    """Return a model with the middle of a large window alone."""
    window, built = model.camera.window, model.conditions.imperfections
    lines = []
    for count in model.camera.mask_shape:
        # The middle stays where it is.
        most = count if count <= _MOST_LINES else _MOST_LINES - (count - _MOST_LINES) % 2
        lines.append(((count - most) // 2, most))
    (top, rows), (left, columns) = lines
    if not (top or left):
        return model
    middle = Window(rows, columns, window.first_row + top, window.first_column + left)
    built = replace(
        built,
        dead_rows=tuple(row - top for row in built.dead_rows if 0 <= row - top < rows),
        dead_columns=tuple(at - left for at in built.dead_columns if 0 <= at - left < columns),
    )
    return replace(
        model,
        camera=replace(model.camera, window=middle),
        conditions=replace(model.conditions, imperfections=built),
    )


def relative(value: Tensor, reference: Tensor) -> float:
    """Root mean square over masks of the relative L2 of ``value`` to ``reference``; masks first.

    Of many weights every mask has about the same error. Of few, one mask may leave the sensor in
    the dark, where little is large. 0 where nothing differs, else 1 for no reference at all.
    """
    differences = (value - reference).flatten(1).norm(dim=1)
    sizes = reference.flatten(1).norm(dim=1)
    if not differences.any():
        return 0.0
    lit = sizes > 0
    return float((differences[lit] / sizes[lit]).square().mean().sqrt()) if lit.any() else 1.0


def pair_sums(down: Tensor, across: Tensor, one: Tensor, other: Tensor) -> Tensor:
    """Return sums over all pairs of ``Re K_y[r, s] K_x[c, d] one[r, c] other[s, d]``.

    Args:
        down: ``K_y``, (offsets y, rows, rows).
        across: ``K_x``, (offsets x, columns, columns).
        one: amplitudes, (masks, rows, columns).
        other: the same shape.

    Returns:
        (masks, offsets y, offsets x).
    """
    return _traced(down, pair_products(across, one, other))


def pair_products(across: Tensor, one: Tensor, other: Tensor) -> Tensor:
    """``one K_x other^T``, (masks, offsets x, rows, rows)."""
    return one[:, None].to(across.dtype) @ across @ other[:, None].mT.to(across.dtype)


def _near(of: Tensor, reach: int) -> Tensor:
    return torch.from_numpy(within_reach(of.numpy(), reach))


def _parted(middles: Values, side: float, parts: int) -> Values:
    """Middles of the parts of pixels, part by part."""
    at = (np.arange(parts) - (parts - 1) / 2) * side / parts
    found: Values = (middles[:, None] + at).ravel()
    return found


def _traced(down: Tensor, spread: Tensor) -> Tensor:
    return torch.einsum("ors,mprs->mop", down, spread).real


def _spread(
    model: Model, lines: int, axis: int, most: int, among: Tensor | None
) -> tuple[Tensor, int]:
    """Return indices (scene pixel slower) of some offsets, and the size of their groups.

    Of few embedding pixels all are kept, for some scene pixels; of more, as many offsets as are
    asked for, evenly spread by size.

    Args:
        model: model whose offsets they are, cropped.
        lines: rows or columns of the whole window.
        axis: 0 for y, 1 for x.
        most: number of offsets that are asked for.
        among: offsets to choose from; None for all.
    """
    embedding = model.embedding.shape[axis]
    if among is None:
        among = torch.arange(model.scene.shape[axis] * embedding)
    pixels = among // embedding
    if embedding <= most:
        pixels = _some(torch.unique(pixels), math.ceil(most / embedding))
        return (pixels[:, None] * embedding + torch.arange(embedding)).flatten(), embedding
    length = (model.camera.sensor.height, model.camera.sensor.width)[axis]
    image = model.scene.pixel_at_sensor(model.camera)
    offsets = (pixels - (model.scene.shape[axis] - 1) / 2) * image
    offsets = offsets + (among % embedding - (embedding - 1) / 2) * (length / embedding)
    order = offsets.argsort(stable=True)
    if model.camera.mask_shape[axis] != lines:
        # Behind the middle of a large window, where its light is.
        pitch = (model.camera.panel.pitch_y, model.camera.panel.pitch_x)[axis]
        moved = model.conditions.imperfections
        away = (offsets - (moved.shift_y, moved.shift_x)[axis]).abs()
        shaded = away[order] <= max(pitch * model.camera.mask_shape[axis] / 2, float(away.min()))
        order = order[shaded]
    kept = _some(among[order], most)
    return kept, len(kept)


def _some(kept: Tensor, most: int) -> Tensor:
    """Return the middle of each of ``most`` equal parts, or all where they are no more."""
    if len(kept) <= most:
        return kept
    return kept[((torch.arange(most) + 0.5) * len(kept) / most).long()]
