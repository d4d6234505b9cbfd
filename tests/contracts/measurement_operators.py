"""What happens to pictures and measurements outside the light: panel and sensor."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from veilcam_optics.apertures import lay_cells, phase_plate, remove_background
from veilcam_optics.camera.masks import quantise
from veilcam_optics.propagation.sampling import Grid, area_average
from veilcam_optics.sensor.noise import shot_noise

from .setting import Bound, Operator, Setting


def _quantise(setting: Setting) -> Bound:
    panel = setting.camera().panel
    return Bound(lambda w: quantise(w, panel), setting.mask_shape, setting.mask_shape)


def _shot_noise(snr_db: float) -> Operator:
    """Noise of one fixed seed: a function of the measurement, smooth but for its amplitude."""

    def bind(setting: Setting) -> Bound:
        def apply(values: Tensor) -> Tensor:
            if values.is_meta:
                return shot_noise(values, snr_db)
            generator = torch.Generator(values.device).manual_seed(3)
            return shot_noise(values, snr_db, generator)

        return Bound(apply, (2, *setting.embedding().shape), (2, *setting.embedding().shape))

    return Operator(
        f"shot noise, {snr_db:g} dB",
        bind,
        # A root has no slope in darkness, which the settings hold some of.
        smooth=snr_db == math.inf,
        mirror=((-2,), (-1,)) if snr_db == math.inf else ((), ()),
        meta=True,
        refuses=False,
        random=snr_db != math.inf,
    )


def _area_average(setting: Setting) -> Bound:
    return Bound(
        lambda values: area_average(values, setting.columns, setting.rows),
        (setting.rows + 7, setting.columns + 4),
        (setting.columns, setting.rows),
        kind="signed",
    )


def _background(setting: Setting) -> Bound:
    shape = (setting.rows + 8, setting.columns + 8)
    light = torch.zeros(shape, dtype=setting.dtype, device=setting.device)
    light[3:-3, 3:-3] = 5.0
    return Bound(lambda image: remove_background(image + light, margin=0.1), shape, shape)


def _phase_plate(setting: Setting) -> Bound:
    wavelength, shape = setting.wavelength, (setting.rows, setting.columns)
    return Bound(lambda h: phase_plate(h * wavelength, wavelength), shape, shape, kind="signed")


def _coded_cells(setting: Setting) -> Bound:
    grid = Grid.square(3 * setting.rows + 2, 2 * setting.columns + 3, setting.pitch)
    feature = 2.3 * setting.pitch
    return Bound(
        lambda cells: lay_cells(cells, feature, grid), (setting.rows, setting.columns), grid.shape
    )


MEASUREMENTS: tuple[Operator, ...] = (
    Operator(
        "coded aperture cells", _coded_cells, linear=True, dtypes=(torch.float64,), refuses=False
    ),
    Operator("phase plate", _phase_plate, batched=True, dtypes=(torch.float64,), refuses=False),
    Operator("background removal", _background, batched=True, dark=False, refuses=False),
    Operator("quantise", _quantise, batched=True, smooth=False, meta=True, refuses=False),
    Operator(
        "area average",
        _area_average,
        linear=True,
        batched=True,
        refuses=False,
        widens="the shares of samples are made in float64, for whatever size is given",
    ),
    _shot_noise(40.0),
    _shot_noise(math.inf),
)
