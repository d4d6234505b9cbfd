"""Error of a mask's rotation, to second order in the angle, interference included.

Turned by a small angle ``a``, the aperture of row ``r`` and column ``c`` moves along y by
``a x_c`` and along x by ``-a y_r``. To first order that adds ``F' (w x) G^T - F (y w) G'^T`` to the
field, a dash being a derivative by the aperture's place. An aperture turns, too: that adds the
same with its own light's lever, ``F' w H^T - H w G'^T``, ``H`` the field weighted with the way from
the aperture's middle. The transfer operator moves the *light* of each pair by what its middle
moves, which leaves out that pairs and apertures turn.
"""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from veilcam_optics.effects.model import Model
from veilcam_optics.plan.boxes import BoxFields, Values, integrals
from veilcam_optics.plan.probe import Probe, lit_rows, pair_sums, relative
from veilcam_optics.transfer.kernels import Axis
from veilcam_optics.transfer.tables import Beam

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
