"""Errors of the product form of the light, as power series.

**Fresnel's approximation** against exact light, to first order: equation (12). Around the ray from
a scene point, exact light is a power series in how far it strays from there. A power along y times
one along x is behind each aperture a product of one-dimensional fields, as the field itself is. So
a probe measures what is left out with all that interferes, and where light is seen: in a dark gap,
say, that is light which an edge sends off at a large angle.

**Rotation of the mask**, to second order in the angle, interference included. Turned by a small
angle ``a``, the aperture of row ``r`` and column ``c`` moves along y by ``a x_c`` and along x by
``-a y_r``. To first order that adds ``F' (w x) G^T - F (y w) G'^T`` to the field, a dash being a
derivative by the aperture's place. An aperture turns, too: that adds the same with its own light's
lever, ``F' w H^T - H w G'^T``, ``H`` the field weighted with the way from the aperture's middle.
The transfer operator moves the *light* of each pair by what its middle moves, which leaves out that
pairs and apertures turn.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from torch import Tensor

from veilcam_optics.effects.light import scene_pixel_tangent
from veilcam_optics.effects.model import Model
from veilcam_optics.plan.probe import Probe, lit_rows, pair_products, pair_sums, relative
from veilcam_optics.transfer.entries import BoxFields, Values, integrals
from veilcam_optics.transfer.kernels import Axis
from veilcam_optics.transfer.tables import Beam

_MOST = 4
"""Highest power: of the phase; of the amplitude the second."""

_WIDE, _PARTS = 0.1, 5
"""Scene pixels from so wide an angle on [rad] are looked at in more parts along each axis."""

Series = dict[tuple[int, int], Tensor]
"""By powers of the stray over the distance along y and x: factors of it, (offsets y, offsets x), or
the light of each."""


@dataclass(frozen=True, slots=True)
class Rays:
    """Rays from scene points through the middle of the mask to the offsets, (offsets y, x).

    Attributes:
        u_y: direction cosine along y.
        u_x: along x.
        cosine: cosine of the angle to the axis.
    """

    u_y: Tensor
    u_x: Tensor
    cosine: Tensor

    @classmethod
    def of(cls, tangents_y: Tensor, tangents_x: Tensor) -> Self:
        """Make the rays of scene points at these tangents; light goes on to the other side."""
        cosine = (1 + tangents_y.square()[:, None] + tangents_x.square()).rsqrt()
        return cls(-tangents_y[:, None] * cosine, -tangents_x * cosine, cosine)


def missing_errors(
    probe: Probe, model: Model, channels: Sequence[int] | None = None
) -> tuple[float, float]:
    """Return the relative L2 of the light that a factored field and a grid leave out.

    Args:
        probe: offsets where light is looked at.
        model: model with diffraction, and the reach of interference that counts.
        channels: channels to look at; None for all.
    """
    model = model.with_sampling(wavelengths=1, layers=1)
    parts = _PARTS if scene_pixel_tangent(model) > _WIDE else 1
    rays = Rays.of(*probe.tangents(model, parts))
    plain, along_y, along_x, spread, factored, grid = (probe.dark(parts) for _ in range(6))
    deep = False
    for beam, scaled in probe.lights(model, channels):
        y, x = probe.axes(model, beam, parts)
        rows, every = lit_rows(model, beam.channel), np.arange(len(x.centres))
        wavelength, reach = float(beam.wavelength), model.sampling.reach
        boxes_y = BoxFields(y, rows, wavelength, reach.rows)
        boxes_x = BoxFields(x, every, wavelength, reach.columns)
        down, across = _powers(boxes_y), _powers(boxes_x)
        share, weights = probe.share(model, beam.channel, parts), scaled[:, torch.from_numpy(rows)]
        found = {of: share * sums for of, sums in _sums(down, across, weights).items()}
        light = found[0, 0].real
        deep_y, deep_x = _deep(boxes_y, boxes_x, (down[0], across[0]), weights)
        deep = deep or deep_y is not None or deep_x is not None
        plain += light
        along_y += light if deep_y is None else share * deep_y
        along_x += light if deep_x is None else share * deep_x
        spread += rays.cosine**2 * (found[2, 0] + found[0, 2]).real
        turns = 2 * math.pi / wavelength * float(y.distance)
        for of, factor in factored_series(rays, turns).items():
            factored += 2 * (factor * found[of]).real
        for of, factor in grid_series(rays, turns).items():
            grid += 2 * (factor * found[of]).real
    fade = rays.cosine**4
    seen, spread, *changes = (
        probe.scattered(model, _whole(fade * light, parts))
        for light in (plain, spread, factored, grid)
    )
    # An edge sends less light out at an angle than Fresnel's: of what strays by s the share
    # 1 / (1 + s^2) arrives; half of that is the flux's. Where phases are off by more than a turn,
    # their first order may hide it, and it is there all the same.
    bright = relative(seen + spread, seen)
    strayed = [bright, bright / 2]
    if deep:
        there = _there(plain, along_y, along_x)
        strayed = [
            relative(seen + more, probe.scattered(model, _whole(fade * arriving, parts)))
            for more, arriving in zip((spread, spread / 2), there, strict=True)
        ]
    factored_error, grid_error = (
        _all_orders(relative(seen + change, seen), most)
        for change, most in zip(changes, strayed, strict=True)
    )
    return factored_error, grid_error


def uneven_error(probe: Probe, model: Model, channels: Sequence[int] | None = None) -> float:
    """Relative L2 of taking a scene pixel for evenly bright, where the sensor sees some of it.

    Oblique parts of it are fainter, by the fourth power of the cosine. Of narrow pixels that is
    nothing: it is 1e-4 of the default camera's.

    Args:
        probe: offsets where light is looked at.
        model: model with the reach of interference that counts.
        channels: channels to look at; None for all.
    """
    if scene_pixel_tangent(model) <= _WIDE:
        return 0.0
    fade = Rays.of(*probe.tangents(model, _PARTS)).cosine ** 4
    light = probe.light(model, channels=channels, parts=_PARTS)
    even, uneven = (
        probe.scattered(model, seen)
        for seen in (_whole(fade, _PARTS) * _whole(light, _PARTS), _whole(fade * light, _PARTS))
    )
    return relative(even, uneven)


def _all_orders(first: float, bright: float) -> float:
    """Sum of a series of which each term is no larger a part of the last than the first is.

    Where there is no such sum, light is wrong by all of itself, or by more: what is too bright.

    Args:
        first: relative L2 of the first order.
        bright: share of the exact light by which it is too bright.
    """
    most = max(first, bright)
    return min(1.0, most / (1 - most)) if most < 0.5 else max(1.0, bright)


def _deep(
    boxes_y: BoxFields, boxes_x: BoxFields, pairs: tuple[Tensor, Tensor], weights: Tensor
) -> tuple[Tensor | None, Tensor | None]:
    """Light that is as faint as exact waves deep in a shadow along y, or along x.

    As far out as no series holds, of light at the tangent ``t`` the share ``1 / t^2`` arrives.

    Args:
        boxes_y: fields along y.
        boxes_x: fields along x.
        pairs: integrals of both as they are.
        weights: (masks, rows, columns).

    Returns:
        (masks, offsets y, offsets x) each; None where no light is so deep in a shadow.
    """
    found: list[Tensor | None] = []
    for axis, boxes in enumerate((boxes_y, boxes_x)):
        if boxes.excess.max() == 1:
            found.append(None)
            continue
        fields = boxes.fields / boxes.excess
        dimmed = torch.from_numpy(boxes.integrated(fields, fields))
        down, across = (pairs[0], dimmed) if axis else (dimmed, pairs[1])
        found.append(pair_sums(down, across, weights, weights))
    return found[0], found[1]


def _there(light: Tensor, deep_y: Tensor, deep_x: Tensor) -> tuple[Tensor, Tensor]:
    """Return the arriving shares of a factored field's light, and of a grid's; see :func:`_deep`.

    What two edges spread along both axes, exact waves make as large; the slanting flux alone makes
    it fainter, by the cosine, as it does all light of a grid.

    Args:
        light: (masks, offsets y, offsets x).
        deep_y: light that arrives, with the stray along y alone considered.
        deep_x: along x.
    """
    lost_y, lost_x = (
        torch.where(deep > 0, light / deep, 1.0).clamp_min(1) for deep in (deep_y, deep_x)
    )
    more = torch.maximum(lost_y, lost_x)
    return light * torch.minimum(lost_y, lost_x).sqrt() / more, light / more.sqrt()


def _whole(light: Tensor, parts: int) -> Tensor:
    """Means over the parts of scene pixels, along the last two axes."""
    rows, columns = light.shape[-2] // parts, light.shape[-1] // parts
    return light.reshape(*light.shape[:-2], rows, parts, columns, parts).mean((-1, -3))


def factored_series(rays: Rays, turns: float) -> Series:
    """Return the series that a factored field leaves out, relative to its own light.

    Args:
        rays: the light's.
        turns: the distance from mask to sensor as a phase [rad].
    """
    series = _oblique(rays, turns)
    fading, phase = -1.25 * rays.cosine**2, -1j * turns / 8 * rays.cosine**3
    for of, factor in (
        *(((2, 0), fading), ((0, 2), fading)),
        *(((4, 0), phase), ((2, 2), 2 * phase), ((0, 4), phase)),
    ):
        series[of] = series.get(of, 0) + factor
    return series


def grid_series(rays: Rays, turns: float) -> Series:
    """Return the series that a grid leaves out: it is exact on the axis, but for the flux.

    Its light at an angle is stretched alike along y and x.
    """
    series = _oblique(rays, turns)
    uneven = -0.25j * turns * rays.cosine * (rays.u_y.square() - rays.u_x.square())
    series[2, 0] = series[2, 0] - 0.25 * rays.cosine**2 + uneven
    series[0, 2] = series[0, 2] - 0.25 * rays.cosine**2 - uneven
    return series


def _oblique(rays: Rays, turns: float) -> Series:
    """Return the series that is left out because the ray is oblique.

    With ``u`` its direction cosines, ``R`` its length and ``s`` the stray, amplitude and phase are
    ``(R0/R)^(5/2)``, two of it the kernel's (Goodman, equation 3-41) and half the flux's, and
    ``k (R - u s)``; of these, ``1`` and the squares along each axis are in the factored field.
    """
    u_y, u_x, cosine = rays.u_y, rays.u_x, rays.cosine
    y2, x2 = u_y.square(), u_x.square()
    square, cube, fourth = (
        45 / 8 * cosine**2,
        -0.5j * turns * cosine**2,
        0.125j * turns * cosine**3,
    )
    mixed = u_y * u_x
    return {
        (1, 0): -2.5 * cosine * u_y,
        (0, 1): -2.5 * cosine * u_x,
        (2, 0): square * y2,
        (0, 2): square * x2,
        (1, 1): 2 * square * mixed - 1j * turns * cosine * mixed,
        (3, 0): cube * u_y * (1 - y2),
        (0, 3): cube * u_x * (1 - x2),
        (2, 1): cube * u_x * (1 - 3 * y2),
        (1, 2): cube * u_y * (1 - 3 * x2),
        (4, 0): fourth * y2 * (6 - 5 * y2),
        (0, 4): fourth * x2 * (6 - 5 * x2),
        (3, 1): fourth * mixed * (12 - 20 * y2),
        (1, 3): fourth * mixed * (12 - 20 * x2),
        (2, 2): fourth * (6 * (y2 + x2) - 30 * y2 * x2),
    }


def _powers(boxes: BoxFields) -> Tensor:
    """Integrals with powers of one field's stray, (powers, offsets, apertures, apertures)."""
    strays = boxes.strays(_MOST)
    return torch.from_numpy(np.stack([boxes.integrated(one, boxes.fields) for one in strays]))


def _sums(down: Tensor, across: Tensor, weights: Tensor) -> Series:
    """Return sums over all pairs, (masks, offsets y, offsets x), for every two powers.

    Args:
        down: along y, (powers, offsets y, rows, rows).
        across: along x, (powers, offsets x, columns, columns).
        weights: (masks, rows, columns).
    """
    found = {}
    for power, one in enumerate(across):
        spread = pair_products(one, weights, weights)
        sums = torch.einsum("aors,mprs->amop", down[: _MOST + 1 - power], spread)
        found.update({(other, power): values for other, values in enumerate(sums)})
    return found


_SMALL = 1e-2
"""Step of the derivatives, in parts of what changes the field by one radian."""

_LEVER = -1
"""Instead of a derivative's order: the field weighted with the way from the aperture's middle."""

Orders = dict[tuple[int, int], Tensor]
"""``K`` of the derivatives of one field and of the other, by their orders."""


def rotation_errors(probe: Probe, model: Model) -> tuple[float, float]:
    """Relative L2 of ignoring the mask's rotation, and of the transfer operator's first order."""
    model = model.with_sampling(wavelengths=1, layers=1)
    total = probe.dark().repeat(3, 1, 1, 1)
    for beam, weights in probe.lights(model):
        total += probe.share(model, beam.channel) * _turned(probe, model, beam, weights)
    plain, change, left = probe.faded(model, total)
    return min(1.0, relative(plain + change, plain)), min(1.0, relative(plain + left, plain))


def _turned(probe: Probe, model: Model, beam: Beam, weights: Tensor) -> Tensor:
    """Return a straight mask's light, its change by turning, and the rest after first order.

    Args:
        probe: offsets where light is looked at.
        model: model with the reach of interference that counts.
        beam: the light.
        weights: amplitudes that it passes, (masks, rows, columns).
    """
    angle = model.conditions.imperfections.rotation
    rows = lit_rows(model, beam.channel)
    weights = weights[:, torch.from_numpy(rows)]
    axis_y, axis_x = probe.axes(model, beam)
    y = torch.from_numpy(axis_y.centres - axis_y.centres.mean())[rows, None]
    x = torch.from_numpy(axis_x.centres - axis_x.centres.mean())
    reach, wavelength = model.sampling.reach, float(beam.wavelength)
    # Where one line alone stays in place, derivatives are by what an aperture's edge would move.
    far_y, far_x = (
        max(abs(angle) * float(other.abs().max()), 1e-3 * axis.width)
        for axis, other in ((axis_y, x), (axis_x, y))
    )
    down = _orders(axis_y, rows, wavelength, reach.rows, far_y)
    across = _orders(axis_x, np.arange(len(x)), wavelength, reach.columns, far_x)

    def total(
        along_y: tuple[int, int], along_x: tuple[int, int], one: Tensor, other: Tensor
    ) -> Tensor:
        return pair_sums(down[along_y], across[along_x], one, other)

    w, wx, wy = weights, weights * x, weights * y
    plain = total((0, 0), (0, 0), w, w)
    turned = 2 * (total((0, 1), (0, 0), w, wx) - total((0, 0), (0, 1), w, wy))
    own = 2 * (total((0, 1), (0, _LEVER), w, w) - total((0, _LEVER), (0, 1), w, w))
    moved = total((0, 1), (0, 0), w, wx) + total((0, 1), (0, 0), wx, w)
    moved -= total((0, 0), (0, 1), w, wy) + total((0, 0), (0, 1), wy, w)
    second = (
        total((1, 1), (0, 0), wx, wx)
        + total((0, 0), (1, 1), wy, wy)
        - 2 * total((1, 0), (0, 1), wx, wy)
        + total((0, 2), (0, 0), w, wx * x)
        + total((0, 0), (0, 2), w, wy * y)
        - 2 * total((0, 1), (0, 1), w, wx * y)
        # What turns comes nearer to the axes, by the cosine.
        - total((0, 1), (0, 0), w, wy)
        - total((0, 0), (0, 1), w, wx)
    )
    change = angle * (turned + own) + angle**2 * second
    return torch.stack([plain, change, change - angle * moved])


def _orders(axis: Axis[Values], of: Values, wavelength: float, reach: int, far: float) -> Orders:
    """Integrals of ``kappa`` with a derivative of each field, by central differences.

    Args:
        axis: axis with the offsets that are wanted.
        of: indices of the apertures.
        wavelength: [m].
        reach: reach of interference.
        far: greatest distance that an aperture moves [m].
    """
    if axis.shadow:
        before, plain, after = (
            _moved(axis, move, lambda: integrals(axis, of, wavelength, 0))
            for move in (-far, 0, far)
        )
        # Nothing interferes: the irradiance's own derivatives.
        slope, curve = (after - before) / (4 * far), (after + before - 2 * plain) / (2 * far**2)
        none = np.zeros_like(plain)
        return _as_torch(
            {
                (0, 0): plain,
                (0, 1): slope,
                (1, 0): slope,
                (1, 1): none,
                (0, 2): curve,
                # An aperture's light is its own mirror image, but for what the box cuts off.
                (0, _LEVER): none,
            }
        )
    seen = float(np.max(abs(axis.offsets)) + np.max(abs(axis.centres - axis.centres.mean())))
    small = _SMALL * min(axis.width, wavelength * float(axis.distance) / (seen + axis.width))
    boxes = BoxFields(axis, of, wavelength, reach)
    before, after = (
        _moved(axis, move, lambda: BoxFields(axis, of, wavelength, reach).fields)
        for move in (-small, small)
    )
    fields = (
        boxes.fields,
        (after - before) / (2 * small),
        (after + before - 2 * boxes.fields) / small**2,
    )
    found = {
        (a, b): boxes.integrated(fields[a], fields[b])
        for a, b in ((0, 0), (0, 1), (1, 0), (1, 1), (0, 2))
    }
    strays = boxes.strays(1)[1] * float(axis.distance)
    lever = (boxes.points[..., None] - axis.centres[of]) * boxes.fields - strays
    found[0, _LEVER] = boxes.integrated(boxes.fields, lever)
    return _as_torch(found)


def _as_torch(found: dict[tuple[int, int], Values]) -> Orders:
    return {of: torch.from_numpy(values) for of, values in found.items()}


def _moved(axis: Axis[Values], move: float, found: Callable[[], Values]) -> Values:
    """Return the integrals while all apertures are moved [m]."""
    centres = axis.centres
    axis.centres = centres + move
    value = found()
    axis.centres = centres
    return value
