"""Waves on grids: illumination, propagation, point spread functions, the grid path."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.illumination import plane_wave, spherical_wave
from veilcam_optics.propagation.psf import PointSpread
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.transfer.grid import GridLight

from .setting import LENGTHS, Bound, Operator, Setting, symmetric_weights

_PHASES = "phases are made in float64 for whatever point, direction or mask is given"
_BOXES = "the phases of an embedding's boxes are made, in float64, when its shape is first known"


def _grid_light(setting: Setting, *, filters: bool) -> GridLight:
    return GridLight(
        setting.camera(filters=filters, leakage=0.1),
        setting.scene(),
        1.1,
        dtype=setting.dtype,
        device=setting.device,
    )


def _grid_psf(name: str, *, filters: bool) -> Operator:
    def bind(setting: Setting) -> Bound:
        light = _grid_light(setting, filters=filters)
        return Bound(light.psf, setting.mask_shape, (3, *light.grid.shape))

    return Operator(name, bind, mirror=((), (-1,)) if filters else ((-2,), (-1,)))


def _grid_embed(name: str, *, colour: bool) -> Operator:
    def bind(setting: Setting) -> Bound:
        light = _grid_light(setting, filters=False)
        psf = light.psf(symmetric_weights(setting))
        embed = light.embed_colour if colour else light.embed
        channels = (3,) if colour else ()
        return Bound(
            lambda scenes: embed(scenes, psf, setting.embedding()),
            (*channels, *setting.scene().shape),
            (*channels, *setting.embedding().shape),
        )

    return Operator(name, bind, linear=True, batched=True, widens=_BOXES)


def _grid_embed_of_psf(setting: Setting) -> Bound:
    """The same as a function of the PSF, for a scene that is its own mirror image."""
    light = _grid_light(setting, filters=False)
    scene = torch.ones(setting.scene().shape, dtype=setting.dtype, device=setting.device)
    return Bound(
        lambda psf: light.embed(scene, psf, setting.embedding()),
        (3, *light.grid.shape),
        setting.embedding().shape,
    )


def _propagation(
    name: str, propagator: AngularSpectrum, *, shifted: bool = False, scale: float = 1.0
) -> Operator:

    def bind(setting: Setting) -> Bound:
        pitch = setting.length("pitch")
        source = Grid(setting.rows, setting.columns, pitch, pitch)
        target = source
        if shifted or scale != 1.0:
            wanted = pitch if scale == 1.0 else pitch * scale
            shift = 3.3 * pitch if shifted else 0.0
            target = Grid(setting.rows + 3, setting.columns + 2, wanted, wanted, shift, -shift)
        propagate = propagator.prepare(
            source,
            target,
            setting.length("distance"),
            setting.length("wavelength"),
            dtype=setting.complex_dtype,
            device=setting.device,
        )
        return Bound(propagate, source.shape, target.shape, kind="field")

    return Operator(
        name,
        bind,
        linear=True,
        batched=True,
        quantities=LENGTHS,
        mirror=((), ()) if shifted else ((-2,), (-1,)),
    )


def _point_spread(name: str, *, scene_distance: float) -> Operator:

    def bind(setting: Setting) -> Bound:
        pitch = setting.length("pitch")
        source = Grid(setting.rows, setting.columns, pitch, pitch)
        target = Grid(setting.rows + 2, setting.columns + 3, pitch, pitch)
        spread = PointSpread(
            source,
            target,
            wavelength=setting.length("wavelength"),
            distance=setting.length("distance"),
            scene_distance=scene_distance * setting.distance,
            dtype=setting.complex_dtype,
            device=setting.device,
        )
        return Bound(spread, source.shape, target.shape, kind="field")

    return Operator(name, bind, batched=True, quantities=LENGTHS)


def _illumination(name: str, *, paraxial: bool) -> Operator:
    """From a scene point, in hundredths of a millimetre, to its wave at the mask."""

    def bind(setting: Setting) -> Bound:
        pitch = setting.length("pitch")
        grid = Grid(setting.rows, setting.columns, pitch, pitch)

        def apply(point: Tensor) -> Tensor:
            return spherical_wave(
                grid,
                setting.length("distance"),
                setting.length("wavelength"),
                point=(1e-5 * point[0], 1e-5 * point[1]),
                paraxial=paraxial,
                dtype=setting.complex_dtype,
                device=setting.device,
            )

        return Bound(apply, (2,), grid.shape, kind="signed")

    return Operator(name, bind, quantities=LENGTHS, mirror=((), ()), refuses=False, widens=_PHASES)


def _tilted_wave(setting: Setting) -> Bound:
    pitch = setting.length("pitch")
    grid = Grid(setting.rows, setting.columns, pitch, pitch)

    def apply(sines: Tensor) -> Tensor:
        return plane_wave(
            grid,
            setting.length("wavelength"),
            direction=(1e-2 * sines[0], 1e-2 * sines[1]),
            dtype=setting.complex_dtype,
            device=setting.device,
        )

    return Bound(apply, (2,), grid.shape, kind="signed")


WAVES: tuple[Operator, ...] = (
    _grid_psf("grid, PSF", filters=False),
    _grid_psf("grid, PSF, leaky filters", filters=True),
    _grid_embed("grid, embed gray", colour=False),
    _grid_embed("grid, embed colour", colour=True),
    Operator("grid, embedding of a PSF", _grid_embed_of_psf, linear=True, widens=_BOXES),
    _propagation("angular spectrum", AngularSpectrum()),
    _point_spread("PSF of a complex mask, near point", scene_distance=50),
    _point_spread("PSF of a complex mask, plane wave", scene_distance=math.inf),
    _illumination("spherical wave, paraxial", paraxial=True),
    _illumination("spherical wave, exact", paraxial=False),
    Operator(
        "plane wave",
        _tilted_wave,
        quantities=("wavelength", "pitch"),
        mirror=((), ()),
        dark=False,
        refuses=False,
        widens=_PHASES,
    ),
    _propagation("angular spectrum, padded by reach", AngularSpectrum(padding="reach")),
    _propagation("angular spectrum, periodic", AngularSpectrum(padding="none")),
    _propagation("angular spectrum, no band limit", AngularSpectrum(band_limit=False)),
    _propagation("angular spectrum, shifted", AngularSpectrum(), shifted=True),
    _propagation(
        "angular spectrum, shifted and scaled", AngularSpectrum(), shifted=True, scale=0.7
    ),
    _propagation("angular spectrum, scaled", AngularSpectrum(), scale=0.7),
)
