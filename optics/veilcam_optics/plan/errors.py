"""Errors at the embedding: of every effect if it were ignored, and of every sampling."""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import CHANNELS
from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.effects.light import fade, scene_pixel_tangent, stretch, tangents, zones
from veilcam_optics.effects.mask import DeadLines, MaskShift
from veilcam_optics.effects.model import Model
from veilcam_optics.effects.sensor import BlackLevel, converter_range
from veilcam_optics.plan.bounds import (
    affordable_reach,
    far_pairs,
    fringe_step,
    meeting_rows,
    nearest_rows,
    resolved,
    shadow_error,
)
from veilcam_optics.plan.grids import GridErrors
from veilcam_optics.plan.probe import Probe, cropped, relative
from veilcam_optics.plan.series import missing_errors, rotation_errors, uneven_error
from veilcam_optics.transfer.tables import Reach

_FINEST = {"wavelengths": 7, "layers": 9}
ROUNDING = {torch.float32: 1.5e-6, torch.float64: 0.0}
"""Relative L2 of a transfer matrix's number format: kernels are cast from float64.

Measured: 1e-7 in the median of 110 small cameras, 1.2e-6 at most; 1.8e-6 where all sub-pixels
interfere and all entries are alike. A prediction is to hold for those, too.
"""

_FEWER, _FEWEST = 6, 4
"""Offsets along each axis where more is wanted of each than its light."""

_PLAIN = 3.0
"""An error that is so many times the tolerance at a few offsets need not be known any better."""

_LARGE = 500
"""Weights of a mask."""

_ALIKE = 0.25
"""Standard deviation of codes that all lie about as far from where the next one begins."""

_SELDOM = 0.01
"""Of so few readings one holds a changed code: what that adds is left out, since a prediction is to
hold in ninety-nine cases of a hundred."""

_AT_ONCE = 0.5
"""Of a code that changes, squared: twice the prediction then holds two of them, or one where a mask
passes less light than others."""

_LEAST_TOLERANCE = 1e-5
"""Below it nothing is sampled any finer: no plan will get there."""


@dataclass(frozen=True, slots=True)
class Interferences:
    """Errors of every reach, for one choice of filters.

    Attributes:
        errors: relative L2 of counting no farther.
        model: the one it belongs to.
    """

    errors: Mapping[Reach, float]
    model: Model


_PLANNING_S = 1.6
"""Time of the processor after which nothing finer is looked at [s]."""


class ErrorModel:
    """Compares models with the one that has everything; see :class:`~...effects.Comparison`.

    Args:
        model: model with every effect on.
        tolerance: errors far below it need not be known.
    """

    def __init__(self, model: Model, tolerance: float) -> None:
        self.tolerance = tolerance
        self._began = time.process_time()
        self._small = max(tolerance, _LEAST_TOLERANCE) / 10
        self._probe = Probe(model)
        self._exact_transfers: dict[tuple[Probe, tuple[int, ...] | None], Tensor] = {}
        panel = model.camera.panel
        lit = shadow_error(model, min(panel.aperture_y, panel.aperture_x))
        self._shadow_error = min(1.0, lit * self._beside_shadows(model))
        # Very near the sensor fringes are too fine to be sampled, and too fine to matter. Where no
        # shadow falls on it either, no more is known than that it is dark.
        matters = self._shadow_error if self._shadow_error < 1 else lit
        self.resolved = 3 * matters > tolerance and resolved(model.with_sampling(reach=Reach(0, 0)))
        """Whether fringes are sampled; else shadows are all that is known."""
        if not self.resolved:
            model = replace(model, sampling=replace(model.sampling, diffraction=False))
        self.full = self.interferences(model)
        """With every effect on."""
        self.model = self.full.model

    def _beside_shadows(self, model: Model) -> float:
        """Light of a centred mask's shadows over what of them a moved mask casts on the sensor.

        What diffraction moves is a share of an aperture's light: of less it is more. At least 1.
        """
        if not MaskShift().present(model):
            return 1.0
        shadows = replace(model, sampling=replace(model.sampling, diffraction=False))
        seen = float(self._probe.transfer(shadows).norm())
        centred = float(self._probe.transfer(MaskShift().without(shadows)).norm())
        return max(1.0, centred / seen) if seen else math.inf

    @property
    def late(self) -> bool:
        """Return whether planning has taken so long that nothing finer is looked at."""
        return time.process_time() - self._began > _PLANNING_S

    def interferences(self, model: Model) -> Interferences:
        """Errors of every reach: near pairs are counted, and what is farther apart is bounded."""
        # A dark line parts two that are lit: the nearest pairs would say that none interfere.
        given, model = model, DeadLines().without(model)
        reach, (down, across) = (
            self._reach(model) if model.sampling.diffraction else (Reach(0, 0), (0.0, 0.0))
        )
        used = model.with_sampling(reach=reach, step=fringe_step(model, reach))
        # Light of several colours or distances blurs the fringes of one another: two samples of
        # each show how much.
        blurred = used.with_sampling(wavelengths=2, layers=2)
        rows, columns = _dials(reach.rows, meeting_rows(model.camera)), _dials(reach.columns)
        found = self._probe.within(blurred, rows, columns)
        errors = {
            Reach(row, column): math.hypot(relative(found[n, k], found[-1, -1]), down, across)
            for n, row in enumerate(rows)
            for k, column in enumerate(columns)
        }
        return Interferences(errors, replace(used, conditions=given.conditions))

    def _reach(self, model: Model) -> tuple[Reach, tuple[float, float]]:
        """Return the reach up to which pairs are counted, and bounds of the rest along y and x."""
        found, bounds = [], []
        nearest = (nearest_rows(model.camera), 1)
        for axis, (unit, count) in enumerate(zip(nearest, model.camera.mask_shape, strict=True)):
            far = far_pairs(model, axis)
            bound = far.flip(0).cumsum(0).flip(0)  # of all pairs at least so far apart
            most = affordable_reach(model, axis, len(self._kept(axis)))
            reach = min(unit, count - 1)
            while reach + 1 < count and reach < most and bound[reach + 1] > self._small / 2:
                reach += 1
            found.append(reach)
            bounds.append(float(bound[reach + 1]) if reach + 1 < count else 0.0)
        return Reach(*found), (bounds[0], bounds[1])

    def _kept(self, axis: int) -> Tensor:
        return (self._probe.kept_y, self._probe.kept_x)[axis]

    @cached_property
    def ideal_filters(self) -> Interferences:
        """As :attr:`full`, with filters that leak nothing."""
        panel = replace(self.model.camera.panel, filter_leakage=0.0, filter_amplitudes=())
        return self.interferences(
            replace(self.model, camera=replace(self.model.camera, panel=panel))
        )

    def error(self, changed: Model) -> float:
        """Relative L2 of the transfer when ``changed`` takes the model's place."""
        if changed == self.model:  # shadows for shadows: what is left out is diffraction
            return self._shadow_error
        near = self._near.sampling
        changed = changed.with_sampling(reach=near.reach, step=near.step)
        # What is alike for all colours is told by one.
        alike = (
            changed.sampling.diffraction == near.diffraction
            and changed.conditions.bayer == self.model.conditions.bayer
            and all(
                changed.camera.row_amplitudes(c) == self.model.camera.row_amplitudes(c)
                for c in range(len(CHANNELS))
            )
        )
        channels = self._telling if alike else None
        for probe in (self._fewer, self._probe):
            error = relative(
                probe.transfer(changed, channels=channels), self._exact(probe, channels)
            )
            if error > _PLAIN * self.tolerance:
                break
        return error

    def _exact(self, probe: Probe, channels: Sequence[int] | None) -> Tensor:
        """Return the transfer that others are compared with; many are."""
        key = probe, None if channels is None else tuple(channels)
        if key not in self._exact_transfers:
            self._exact_transfers[key] = probe.transfer(self._near, channels=channels)
        return self._exact_transfers[key]

    @cached_property
    def _telling(self) -> list[int]:
        """Channels that tell for all: of a large mask, which takes long, the brightest."""
        rows, columns = self.model.camera.mask_shape
        return self._probe.channels(self.model)[: 1 if rows * columns > _LARGE else None]

    @cached_property
    def _near(self) -> Model:
        """The model with as much interference as the tolerance needs, to judge other effects by.

        Where no reach is enough it is the farthest.
        """
        errors = self.full.errors
        last = list(errors)[-1]
        near = min(nearest_rows(self.model.camera), last.rows)
        enough = [
            reach
            for reach, error in errors.items()
            if reach.rows >= near and error <= self.tolerance
        ] or [last]
        reach = min(enough, key=lambda r: ((r.rows + 1) * (2 * r.columns + 1), r.rows))
        return self.model.with_sampling(reach=reach, step=fringe_step(self.model, reach))

    def interference(self) -> float:
        """Relative L2 when no two sub-pixels interfere."""
        return self.full.errors[Reach(0, 0)]

    def rotated(self, *, first_order: bool = False) -> float:
        """Relative L2 of ignoring the mask's rotation, or of counting it to first order."""
        return self._rotated[1 if first_order else 0]

    @cached_property
    def _rotated(self) -> tuple[float, float]:
        return rotation_errors(self._probe, self._near)

    def sampled(self, name: str, count: int) -> float:
        """Relative L2 of ``count`` samples of ``"wavelengths"`` or ``"layers"``."""
        # Of all channels: their errors partly average out in a gray measurement.
        finest = self._fewer.transfer(self._near.with_samples(name, _FINEST[name]))
        return relative(self._fewer.transfer(self._near.with_samples(name, count)), finest)

    def off_axis(self, count: int | None) -> float:
        """Relative L2 with so many zones along each side; None: as if the field were flat."""
        kept = fade(self.model)
        errors = torch.zeros_like(kept)
        for actual, taken, slope in zip(
            self._stretches, _taken(self.model, count), self._slopes, strict=True
        ):
            errors = errors + slope**2 * (actual - taken.log()).square().mean(0)
        errors = errors + brightness_errors(self.model, count) + self._uneven**2
        if count is None:
            errors = errors + (1 / kept.clamp_min(1e-12) - 1).square()
        return min(1.0, float(((errors * kept.square()).mean() / kept.square().mean()).sqrt()))

    @cached_property
    def _uneven(self) -> float:
        return uneven_error(Probe(self.model, _FEWEST), self._near, self._telling)

    @cached_property
    def _stretches(self) -> tuple[Tensor, Tensor]:
        down, across = _in_pixels(self.model)
        return down.log(), across.log()

    @cached_property
    def _slopes(self) -> tuple[float, float]:
        """Relative change of the transfer per relative change of the wavelength along y and x."""
        telling = self._telling
        base = self._exact(self._probe, telling)
        return tuple(  # type: ignore[return-value]
            relative(self._probe.transfer(self._near, stretch, channels=telling), base)
            / math.log(1.02)
            for stretch in ((1.02, 1.0), (1.0, 1.02))
        )

    @cached_property
    def _white(self) -> Tensor:
        """Through a probe for one scene pixel as large as the scene."""
        scene = self.model.scene
        side = scene.pixel * math.sqrt(scene.rows * scene.columns)
        model = replace(self._near, scene=replace(scene, rows=1, columns=1, height=side))
        model = model.with_sampling(step=fringe_step(model, model.sampling.reach))
        return Probe(model).transfer(model)

    def white(self) -> Tensor:
        """Noiseless embeddings of a white scene, (masks, rows, columns): some rows and columns."""
        return self._white

    def paraxial(self) -> float:
        """Relative L2 of Fresnel's approximation, which every factored field makes."""
        return self._missing[0]

    @cached_property
    def _fewer(self) -> Probe:
        return Probe(self.model, _FEWER, self._probe)

    @cached_property
    def _missing(self) -> tuple[float, float]:
        """Relative L2 of the light that factored fields, and grids, leave out; 0 of shadows."""
        if not self.model.sampling.diffraction:
            return 0.0, 0.0
        return missing_errors(self._fewer, self.model, self._telling)

    def read(self, error: float) -> float:
        """Relative L2 of what the camera reads, of an error of the light."""
        if not self.model.conditions.adc_bits or not error:
            return error
        return converted(error, self._white, self.model.conditions, self.model.embedding.size)

    def rounding(self, dtype: torch.dtype) -> float:
        """Relative L2 of a number format; an offset rounds light that is fainter than it."""
        if not self.model.conditions.black_level:
            return ROUNDING[dtype]
        offset = BlackLevel().error(self)
        return min(1.0, math.hypot(ROUNDING[dtype], torch.finfo(dtype).eps * offset))

    def grids(self, model: Model, least: float) -> GridErrors:
        """Errors of the grids of a model, from the coarsest oversampling on."""
        return GridErrors(cropped(model), least, self._probe.masks)

    def off_grid(self) -> float:
        """Relative L2 of what every grid leaves out of exact light, however fine."""
        return self._missing[1]


def _dials(reach: int, meeting: Iterable[int] | None = None) -> list[int]:
    """Reaches that are looked at, up to the farthest: all of the near ones, some of the far.

    Args:
        reach: the farthest.
        meeting: distances of two lines that interfere at all; None for any distance.
    """
    there = range(reach + 1) if meeting is None else sorted({0, reach, *meeting})
    found = [0]
    for dial in there:
        if found[-1] < dial <= reach and (dial == reach or dial >= found[-1] * 3 // 2):
            found.append(dial)
    return found


def _taken(model: Model, count: int | None) -> tuple[Tensor, Tensor]:
    """Factors on the wavelength along y and x that zones take for every scene pixel's."""
    found = torch.ones(2, *model.scene.shape, dtype=torch.float64)
    if count is not None:
        for row in zones(model.with_sampling(zones=count)):
            for zone in row:
                along_y, along_x = zone.stretch
                found[0, zone.rows, zone.columns] = along_y
                found[1, zone.rows, zone.columns] = along_x
    return found[0], found[1]


def _in_pixels(model: Model) -> tuple[Tensor, Tensor]:
    """Factors on the wavelength along y and x at nine nodes of every scene pixel, (9, *scene)."""
    y, x = tangents(model)
    nodes = torch.from_numpy(np.polynomial.legendre.leggauss(3)[0])
    nodes = nodes * scene_pixel_tangent(model) / 2
    down, across = torch.cartesian_prod(nodes, nodes).T
    return stretch(
        (y[:, None] + down[:, None, None]).expand(9, *model.scene.shape),
        (x + across[:, None, None]).expand(9, *model.scene.shape),
    )


def brightness_errors(model: Model, count: int | None) -> Tensor:
    """Squares of the relative error of the brightness over the mask, for every scene pixel.

    Factors along y and x stand for it: each takes the tangent along the other axis for
    its root mean square in a zone. Without zones, the mask is taken for evenly bright.

    Args:
        model: model with the mask and the scene.
        count: zones along each side; None for an evenly bright mask.

    Returns:
        (scene rows, scene columns).
    """
    camera, distance = model.camera, model.scene.distance
    y, x = tangents(model)
    nodes = torch.from_numpy(np.polynomial.legendre.leggauss(3)[0])
    # Light from farther out on the mask than this misses the sensor.
    sides = (
        min(rows * pitch, lit) / 2 / distance
        for rows, pitch, lit in zip(
            camera.mask_shape,
            (camera.panel.pitch_y, camera.panel.pitch_x),
            camera.lit_sides(model.scene),
            strict=True,
        )
    )
    down, across = (
        (at[:, None] - side * nodes).square() for at, side in zip((y, x), sides, strict=True)
    )
    y2, x2 = y.square(), x.square()
    whole = 1 + down[:, None, :, None] + across[None, :, None, :]
    exact = (whole / (1 + y2[:, None] + x2)[:, :, None, None]).log()
    taken = torch.zeros_like(exact)
    if count is not None:
        for row in zones(model.with_sampling(zones=count)):
            for zone in row:
                other_y, other_x = x2[zone.columns].mean(), y2[zone.rows].mean()
                along_y = ((1 + other_y + down) / (1 + other_y + y2)[:, None]).log()
                along_x = ((1 + other_x + across) / (1 + other_x + x2)[:, None]).log()
                taken[zone.rows, zone.columns] = (
                    along_y[zone.rows, None, :, None] + along_x[None, zone.columns, None, :]
                )
    return (1.5 * (exact - taken)).square().mean((-2, -1))


def converted(error: float, values: Tensor, conditions: Conditions, pixels: int) -> float:
    """Relative L2 of what is read, of an error of the light: equation (13).

    Two values that are ``e`` of a step apart are rounded to different codes in ``e`` of all cases,
    and are a whole step apart then: a small error of faint light grows. What is below half a step
    has nothing to fall to: it changes if the error lifts it above.

    Codes are whole: of a reading none is changed, or one at least, or all where all are alike. What
    changes in few readings is little as a mean over them, and much where it does: a prediction is
    to hold there, too.

    Args:
        error: relative L2 of the light.
        values: noiseless embeddings of a white scene, (masks, rows, columns).
        conditions: conditions with a converter.
        pixels: values in a reading.
    """
    step = converter_range(conditions) / (2**conditions.adc_bits - 1)
    sizes = values.square().mean((-2, -1), keepdim=True).sqrt()
    lit = sizes.flatten() > 0
    if not lit.any():
        return error
    values, sizes = values[lit], sizes[lit]
    off = error * sizes / step
    if conditions.full_well:
        values = values.clamp_max(conditions.full_well / conditions.electrons)
    codes = ((values + conditions.black_level) / step).clamp_max(2**conditions.adc_bits - 1)
    if float(codes.std(correction=0)) > _ALIKE:
        changed = (math.sqrt(2 / math.pi) * off).expand_as(codes)  # the mean size of a normal error
        lifted = torch.erfc((0.5 - codes) / (math.sqrt(2) * off)) / 2
        changed = torch.where(codes < 0.5, torch.minimum(lifted, changed), changed)
        least = 1 / pixels
    else:
        away = (codes % 1 - 0.5).abs().amin()
        changed = torch.erfc(away / (math.sqrt(2) * off))
        least = 1.0
    shares = changed.clamp_max(1).expand_as(codes).mean((-2, -1))
    if float(shares.mean()) * pixels < _SELDOM:
        return error
    seen = shares * pixels >= _SELDOM
    shares = torch.where(seen, shares.clamp_min(_AT_ONCE * least), shares)
    return math.hypot(error, float((shares * (step / sizes.flatten()).square()).mean().sqrt()))
