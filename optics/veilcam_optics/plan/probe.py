"""A cheap look at transfer matrices: a few random masks, a few offsets, in float64.

What an approximation costs in accuracy is measured on these, relative L2, for masks of independent
uniform weights. A transfer matrix has one entry for each offset along y and each along x; some of
them, evenly spread, stand for all.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from veilcam_optics.effects.composition import beams, collected, shown
from veilcam_optics.effects.mask import actual_camera
from veilcam_optics.effects.model import Model
from veilcam_optics.transfer.kernels import Axis
from veilcam_optics.transfer.operator import Beam, make_axes

_OFFSETS = 80
"""Offsets kept of each axis."""

_WEIGHTS = 4000
"""Random weights in all masks together, and hence how well chance averages out."""

MAX_VALUES = 1_200_000
"""Largest number of field values of one axis: 20 MB, and half a second."""

_Down = tuple[Tensor, Tensor, Tensor]
"""Upper rows of the pairs that pass light, what their filters pass, and their kernels."""


class Probe:
    """Masks and offsets at which models are compared.

    Args:
        model: gives camera, scene and embedding; all compared models share their shapes.
        offsets: offsets kept of each axis.
    """

    def __init__(self, model: Model, offsets: int = _OFFSETS) -> None:
        rows, columns = model.camera.mask_shape
        count = min(16, max(2, math.ceil(_WEIGHTS / (rows * columns))))
        generator = torch.Generator().manual_seed(0)
        self.masks = torch.rand(count, rows, columns, generator=generator, dtype=torch.float64)
        scene, embedding = model.scene, model.embedding
        self._kept: dict[object, tuple[list[_Down], list[Tensor]]] = {}
        self.kept_y = _spread(model, scene.rows, embedding.rows, 0, offsets)
        self.kept_x = _spread(model, scene.columns, embedding.columns, 1, offsets)

    def axes(self, model: Model, beam: Beam) -> tuple[Axis, Axis]:
        """The axes of ``model``, reduced to the kept offsets."""
        scene = model.scene
        if beam.scene_distance is not None:
            scene = replace(scene, distance=beam.scene_distance)
        y, x = make_axes(
            model.camera,
            scene,
            model.embedding,
            step=model.sampling.step,
            approximation=model.approximation,
            imperfections=model.conditions.imperfections,
        )
        y.offsets, x.offsets = y.offsets[self.kept_y], x.offsets[self.kept_x]
        return y, x

    def channels(self, model: Model) -> list[int]:
        """Channels that count in a gray measurement, brightest first; at least one."""
        shares = model.camera.sensor.channel_weights
        light = [
            share * sum(amplitude**2 for amplitude in model.camera.row_amplitudes(channel))
            for channel, share in enumerate(shares)
        ]
        order = sorted(range(len(light)), key=lambda channel: -light[channel])
        return [channel for channel in order if light[channel]] or order[:1]

    def transfer(
        self,
        model: Model,
        channels: Sequence[int] | None = None,
        stretch: tuple[float, float] = (1.0, 1.0),
    ) -> Tensor:
        """Gray transfer of every mask at the kept offsets, (masks, offsets y, offsets x).

        Fading over the field, rotation and the sensor are left out.
        """
        # The mean over what is kept stands for that over all.
        return collected(model, self.shells(model, channels, stretch).sum((0, 1)), (1, 2))

    def rotated(self, model: Model) -> tuple[float, float]:
        """Relative L2 of ignoring the mask's rotation, and of counting it to first order.

        Turned by a small angle, row ``r`` moves along x by ``-angle y_r`` and column ``c`` along y
        by ``angle x_c``; the light of each sub-pixel moves with it. The second order of that stands
        for what the first leaves out. Interference is left out.
        """
        angle, camera = model.conditions.imperfections.rotation, actual_camera(model)
        channel = self.channels(model)[0]
        beam = next(b for b in beams(model) if b.channel == channel)
        middles: list[Tensor] = []
        orders: list[list[Tensor]] = []
        axes = self.axes(model, beam)
        for axis, other in zip(axes, reversed(axes), strict=True):
            all_of = torch.arange(len(axis.centres))
            fields = axis.fields(beam.wavelength)
            far = abs(angle) * float(other.middles(*2 * [torch.arange(len(other.centres))]).max())
            far = max(far * float(axis.magnification), 1e-3 * axis.step)
            kernel = axis.kernel(fields, all_of, all_of).real
            offsets, ends = axis.offsets, axis.offsets.abs().max()
            moved = []
            for sign in (1, -1):
                axis.offsets = (offsets + sign * far).clamp(-ends, ends)
                moved.append(axis.kernel(fields, all_of, all_of).real)
            axis.offsets = offsets
            slope = (moved[0] - moved[1]) / (2 * far) * float(axis.magnification)
            curve = (moved[0] + moved[1] - 2 * kernel) / far**2 * float(axis.magnification) ** 2
            orders.append([kernel, slope, curve])
            middles.append(axis.middles(all_of, all_of))
        (kernel_y, slope_y, curve_y), (kernel_x, slope_x, curve_x) = orders
        y, x = middles[0][:, None], middles[1]
        amplitudes = torch.tensor(camera.row_amplitudes(beam.channel), dtype=torch.float64)
        squares = (shown(model, self.masks) * amplitudes[:, None]).square()
        straight = kernel_y @ squares @ kernel_x.T
        first = kernel_y @ (squares * y) @ slope_x.T - slope_y @ (squares * x) @ kernel_x.T
        second = (
            kernel_y @ (squares * y * y) @ curve_x.T / 2
            + curve_y @ (squares * x * x) @ kernel_x.T / 2
            - slope_y @ (squares * y * x) @ slope_x.T
        )
        ignored = relative(straight + angle * first + angle**2 * second, straight)
        return min(1.0, ignored), min(1.0, relative(straight + angle**2 * second, straight))

    def shells(
        self,
        model: Model,
        channels: Sequence[int] | None = None,
        stretch: tuple[float, float] = (1.0, 1.0),
    ) -> Tensor:
        """The transfer, parted by how far apart the sub-pixels are that interfere.

        Returns:
            (rows apart, columns apart, masks, offsets y, offsets x).
        """
        used = self.channels(model) if channels is None else channels
        rows, columns = model.camera.mask_shape
        reach = model.sampling.reach
        if not model.sampling.diffraction:
            reach = type(reach)(0, 0)
        far_rows, far_columns = min(reach.rows, rows - 1), min(reach.columns, columns - 1)
        shells = torch.zeros(
            far_rows + 1,
            far_columns + 1,
            len(self.masks),
            len(self.kept_y),
            len(self.kept_x),
            dtype=torch.float64,
        )
        weights = shown(model, self.masks)
        for beam in beams(model):
            if beam.channel not in used:
                continue
            self._add(shells, model, beam, weights, stretch)
        return shells

    def _add(
        self,
        shells: Tensor,
        model: Model,
        beam: Beam,
        weights: Tensor,
        stretch: tuple[float, float],
    ) -> None:
        """Add one beam's light to every shell."""
        columns = weights.shape[-1]
        share = beam.share * model.camera.sensor.channel_weights[beam.channel]
        kernels = self._kernels(model, beam, stretch, (shells.shape[0], shells.shape[1]))
        for dr, (first, passed, down) in enumerate(kernels[0]):
            if not len(first):
                continue
            scaled = down * (passed * share)
            one, other = weights[:, first], weights[:, first + dr]
            for dc, across in enumerate(kernels[1]):
                width = columns - dc
                value = _real_product(scaled, one[..., :width] * other[..., dc:], across)
                if dr and dc:  # columns apart the other way
                    pairs = one[..., dc:] * other[..., :width]
                    value = value + _real_product(scaled, pairs, across.conj())
                shells[dr, dc] += value if dr == dc == 0 else 2 * value

    def _kernels(
        self, model: Model, beam: Beam, stretch: tuple[float, float], near: tuple[int, int]
    ) -> tuple[list[_Down], list[Tensor]]:
        """Kernels of rows 0, 1, ... apart and of columns apart, kept: masks do not change them."""
        key = (
            actual_camera(model),
            model.conditions.imperfections.shift_y,
            model.conditions.imperfections.shift_x,
            model.approximation,
            model.sampling.step,
            replace(beam, share=1.0),
            stretch,
            near,
        )
        if key not in self._kept:
            y, x = self.axes(model, beam)
            rows, columns = model.camera.mask_shape
            amplitudes = torch.tensor(
                model.camera.row_amplitudes(beam.channel), dtype=torch.float64
            )
            fields_y = y.fields(beam.wavelength * stretch[0], of=amplitudes.nonzero().flatten())
            fields_x = x.fields(beam.wavelength * stretch[1])
            down = []
            for dr in range(near[0]):
                product = amplitudes[: rows - dr] * amplitudes[dr:]
                first = product.nonzero().flatten()
                down.append((first, product[first], y.kernel(fields_y, first, first + dr)))
            across = [
                x.kernel(fields_x, torch.arange(columns - dc), torch.arange(dc, columns))
                for dc in range(near[1])
            ]
            self._kept[key] = (down, across)
        return self._kept[key]


def relative(value: Tensor, reference: Tensor) -> float:
    """Relative L2 of ``value`` to ``reference``; 0 where both are zero, else 1 for no reference."""
    difference, size = float((value - reference).norm()), float(reference.norm())
    if difference == 0:
        return 0.0
    return difference / size if size else 1.0


def _real_product(down: Tensor, pairs: Tensor, across: Tensor) -> Tensor:
    """Re(down pairs across^T), (masks, offsets y, offsets x)."""
    real = down.real @ pairs @ across.real.T
    return real - down.imag @ pairs @ across.imag.T


def _spread(model: Model, scene: int, embedding: int, axis: int, most: int) -> Tensor:
    """Indices (scene pixel slower) of at most ``most`` offsets, evenly spread by size."""
    length = (model.camera.sensor.height, model.camera.sensor.width)[axis]
    image = model.scene.pixel_at_sensor(model.camera)
    at_pixel = (torch.arange(embedding, dtype=torch.float64) - (embedding - 1) / 2) * (
        length / embedding
    )
    at_scene = (torch.arange(scene, dtype=torch.float64) - (scene - 1) / 2) * image
    order = (at_scene[:, None] + at_pixel).flatten().argsort(stable=True)
    if len(order) <= most:
        return order
    # The middle of each of ``most`` equal parts.
    return order[((torch.arange(most) + 0.5) * len(order) / most).long()]
