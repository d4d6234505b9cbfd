"""A cheap look at transfer matrices: a few random masks, a few entries, in float64.

What an approximation costs in accuracy is measured on these, relative L2, for masks of independent
uniform weights. A transfer matrix has one entry for each offset along y and each along x; some of
them, evenly spread, stand for all. For one entry the light is wanted on two boxes alone, and there
the fields of all apertures are known: with ``K[r, s]`` the integral of ``kappa F_r conj(F_s)``, an
entry is the sum over ``K_y[r, s] K_x[c, d] w[r, c] w[s, d]``, of near pairs and of far ones.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from veilcam_optics.effects.composition import beams, collected, shown
from veilcam_optics.effects.mask import actual_camera
from veilcam_optics.effects.model import Model
from veilcam_optics.plan.boxes import bends, integrals
from veilcam_optics.transfer.kernels import Axis
from veilcam_optics.transfer.operator import Beam, make_axes

_OFFSETS = 12
"""Offsets kept of each axis."""

_WEIGHTS = 4000
"""Random weights in all masks together, and hence how well chance averages out."""


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
        self._kept: dict[object, tuple[Tensor, Tensor, Tensor]] = {}
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
        stretch: tuple[float, float] = (1.0, 1.0),
        *,
        channels: Sequence[int] | None = None,
    ) -> Tensor:
        """Gray transfer of every mask at the kept offsets, (masks, offsets y, offsets x).

        Fading over the field, rotation and the sensor are left out.
        """
        total = torch.zeros(len(self.masks), len(self.kept_y), len(self.kept_x)).double()
        for beam, scaled in self._lights(model, channels):
            rows, down, across = self._integrals(model, beam, stretch)
            weights = scaled[:, rows]
            total += pair_sums(down, across, weights, weights)
        # The mean over what is kept stands for that over all.
        return collected(model, total, (1, 2))

    def bend(self, model: Model) -> Tensor:
        """Sum of the second derivatives of :meth:`transfer` by the offset along y and x [1/m^2].

        The second derivative of the kernel's box is four points at its corners.
        """
        total = torch.zeros(len(self.masks), len(self.kept_y), len(self.kept_x)).double()
        for beam, scaled in self._lights(model):
            rows, down, across = self._integrals(model, beam, (1.0, 1.0))
            y, x = self.axes(model, beam)
            bent_down = bends(y, rows, float(beam.wavelength), model.sampling.reach.rows)
            every = torch.arange(len(x.centres))
            bent_across = bends(x, every, float(beam.wavelength), model.sampling.reach.columns)
            weights = scaled[:, rows]
            for along_y, along_x in ((bent_down, across), (down, bent_across)):
                total += pair_sums(along_y, along_x, weights, weights)
        return total

    def shells(self, model: Model) -> Tensor:
        """The transfer, parted by how far apart the sub-pixels are that interfere.

        Returns:
            (rows apart, columns apart, masks, offsets y, offsets x).
        """
        rows, columns = model.camera.mask_shape
        reach = model.sampling.reach
        if not model.sampling.diffraction:
            reach = type(reach)(0, 0)
        far_rows, far_columns = min(reach.rows, rows - 1), min(reach.columns, columns - 1)
        shape = (len(self.masks), len(self.kept_y), len(self.kept_x))
        shells = torch.zeros(far_rows + 1, far_columns + 1, *shape, dtype=torch.float64)
        for beam, scaled in self._lights(model):
            used, down, across = self._integrals(model, beam, (1.0, 1.0))
            weights = scaled[:, used]
            apart = used[None, :] - used[:, None]
            for dc in range(far_columns + 1):
                band = across.diagonal(dc, 1, 2)[:, None, :] * weights[:, None, :, : columns - dc]
                spread = band @ weights[:, None, :, dc:].mT.to(band.dtype)
                if dc:  # columns apart the other way
                    spread = spread + spread.mH
                for dr in range(far_rows + 1):
                    first, second = (apart == dr).nonzero(as_tuple=True)
                    value = torch.einsum(
                        "on,mpn->mop", down[:, first, second], spread[:, :, first, second]
                    )
                    shells[dr, dc] += (2 if dr else 1) * value.real
        return shells

    def _lights(
        self, model: Model, channels: Sequence[int] | None = None
    ) -> list[tuple[Beam, Tensor]]:
        """Each beam with the amplitudes that it passes, its share included."""
        used = self.channels(model) if channels is None else channels
        weights = shown(model, self.masks)
        found = []
        for beam in beams(model):
            share = beam.share * model.camera.sensor.channel_weights[beam.channel]
            if beam.channel in used and share > 0:
                passed = torch.tensor(
                    model.camera.row_amplitudes(beam.channel), dtype=torch.float64
                )
                found.append((beam, weights * (passed * math.sqrt(share))[:, None]))
        return found

    def _integrals(
        self, model: Model, beam: Beam, stretch: tuple[float, float]
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Rows that pass light, and ``K`` along y and x; kept, since masks do not change them."""
        key = (
            actual_camera(model),
            model.conditions.imperfections.shift_y,
            model.conditions.imperfections.shift_x,
            model.approximation,
            model.sampling.reach,
            replace(beam, share=1.0),
            stretch,
        )
        if key not in self._kept:
            y, x = self.axes(model, beam)
            amplitudes = torch.tensor(model.camera.row_amplitudes(beam.channel))
            rows, columns = amplitudes.nonzero().flatten(), torch.arange(len(x.centres))
            reach = model.sampling.reach
            self._kept[key] = (
                rows,
                integrals(y, rows, float(beam.wavelength) * stretch[0], reach.rows),
                integrals(x, columns, float(beam.wavelength) * stretch[1], reach.columns),
            )
        return self._kept[key]


def relative(value: Tensor, reference: Tensor) -> float:
    """Relative L2 of ``value`` to ``reference``; 0 where both are zero, else 1 for no reference."""
    difference, size = float((value - reference).norm()), float(reference.norm())
    if difference == 0:
        return 0.0
    return difference / size if size else 1.0


def pair_sums(down: Tensor, across: Tensor, one: Tensor, other: Tensor) -> Tensor:
    """Sums over all pairs of ``Re K_y[r, s] K_x[c, d] one[r, c] other[s, d]``.

    Args:
        down: ``K_y``, (offsets y, rows, rows).
        across: ``K_x``, (offsets x, columns, columns).
        one: amplitudes, (masks, rows, columns).
        other: the same shape.

    Returns:
        (masks, offsets y, offsets x).
    """
    first, second = one[:, None].to(across.dtype), other[:, None].to(across.dtype)
    return torch.einsum("ors,mprs->mop", down, first @ across @ second.mT).real


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
