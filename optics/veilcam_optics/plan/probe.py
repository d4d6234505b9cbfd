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
from veilcam_optics.transfer.factored import aperture_fields
from veilcam_optics.transfer.kernels import Axis
from veilcam_optics.transfer.operator import Beam, make_axes

_OFFSETS = 12
"""Offsets kept of each axis."""

_WEIGHTS = 4000
"""Random weights in all masks together, and hence how well chance averages out."""

_CELLS = 24
"""Fewest cells in the box of an offset."""

_NODES_IN_FRINGE = 2.2
"""Above 2: each product of two fields is limited to a band, and these are enough to know it."""


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
            total += _summed(down, across, weights)
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
            bent_down = _corners(y, rows, beam.wavelength, model.sampling.reach.rows)
            every = torch.arange(len(x.centres))
            bent_across = _corners(x, every, beam.wavelength, model.sampling.reach.columns)
            weights = scaled[:, rows]
            for along_y, along_x in ((bent_down, across), (down, bent_across)):
                total += _summed(along_y, along_x, weights)
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
                _integrals(y, rows, float(beam.wavelength) * stretch[0], reach.rows),
                _integrals(x, columns, float(beam.wavelength) * stretch[1], reach.columns),
            )
        return self._kept[key]

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


def relative(value: Tensor, reference: Tensor) -> float:
    """Relative L2 of ``value`` to ``reference``; 0 where both are zero, else 1 for no reference."""
    difference, size = float((value - reference).norm()), float(reference.norm())
    if difference == 0:
        return 0.0
    return difference / size if size else 1.0


def _summed(down: Tensor, across: Tensor, weights: Tensor) -> Tensor:
    """Sum over all pairs of ``K_y[r, s] K_x[c, d] w[r, c] w[s, d]``, (masks, offsets y, x)."""
    amplitudes = weights[:, None].to(across.dtype)
    return torch.einsum("ors,mprs->mop", down, amplitudes @ across @ amplitudes.mT).real


def box_cells(side: float, wavelength: float, distance: float, apart: float) -> int:
    """Cells of a box of ``side`` [m] that resolve the fringes of points ``apart`` [m]."""
    return math.ceil(max(_CELLS, _NODES_IN_FRINGE * side * apart / (wavelength * distance)))


def _integrals(axis: Axis, of: Tensor, wavelength: float, reach: int) -> Tensor:
    """Integrals of ``kappa F_r conj(F_s)``, (offsets, apertures, apertures), r, s within reach."""
    if axis.shadow:
        return torch.diag_embed(axis.kernel(axis.fields(wavelength), of, of))
    pixel, image = axis.pixel, float(axis.image)
    outer, inner = (pixel + image) / 2, abs(pixel - image) / 2
    apart = axis.width + min(reach, len(axis.centres) - 1) * _pitch(axis)
    cells = box_cells(2 * outer, wavelength, float(axis.distance), apart)
    edges = torch.linspace(-outer, outer, cells + 1, dtype=torch.float64)
    below = torch.zeros_like(edges)
    for corner, sign in ((-outer, 1), (-inner, -1), (inner, -1), (outer, 1)):
        below += sign * (edges - corner).clamp_min(0).square() / 2
    points = axis.offsets[:, None] + (edges[1:] + edges[:-1]) / 2
    fields = _fields(axis, points, of, wavelength)
    weighted = fields * (axis.scale * below.diff())[:, None]
    return (weighted.mT @ fields.conj()) * _near(of, reach)


def _corners(axis: Axis, of: Tensor, wavelength: float | Tensor, reach: int) -> Tensor:
    """Second derivative by the offset of :func:`_integrals`, same shape."""
    if axis.shadow:
        return torch.zeros(len(axis.offsets), len(of), len(of), dtype=torch.complex128)
    outer, inner = (axis.pixel + float(axis.image)) / 2, (axis.pixel - float(axis.image)) / 2
    corners = torch.tensor([-outer, -inner, inner, outer], dtype=torch.float64)
    signs = torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64)
    fields = _fields(axis, axis.offsets[:, None] + corners, of, float(wavelength))
    weighted = fields * (axis.scale * signs)[:, None]
    return (weighted.mT @ fields.conj()) * _near(of, reach)


def _fields(axis: Axis, points: Tensor, of: Tensor, wavelength: float) -> Tensor:
    """Fields of some apertures at ``points`` (offsets, n): (offsets, n, apertures)."""
    fields = aperture_fields(
        points.flatten(),
        axis.centres[of],
        axis.width,
        wavelength=wavelength,
        source_distance=axis.source_distance,
        distance=axis.distance,
    )
    return fields.reshape(*points.shape, len(of))


def _near(of: Tensor, reach: int) -> Tensor:
    return (of[:, None] - of).abs() <= reach


def _pitch(axis: Axis) -> float:
    return float(axis.centres[1] - axis.centres[0]) if len(axis.centres) > 1 else 0.0


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
