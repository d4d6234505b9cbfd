"""Light with everything that camera and scene may do to it, by each method; and its measurement."""

from __future__ import annotations

from functools import partial

from torch import Tensor

from veilcam_optics.camera.imperfections import Conditions, Imperfections
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.effects.composition import read
from veilcam_optics.effects.model import Method
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.tables import Reach

from .setting import Bound, Operator, Setting, measurement_model, symmetric_weights


def _model(setting: Setting, method: Method, *, field: bool, rotation: float = 0.0) -> Model:
    """Every linear effect: with a field of several zones, or with spectra and depth."""
    scene = setting.scene()
    return Model(
        setting.camera(filters=True, leakage=0.1),
        scene,
        setting.embedding(),
        Conditions(
            bandwidth=(20e-9, 20e-9, 20e-9),
            depth_range=0.2 * scene.distance,
            imperfections=Imperfections(
                gamma=1.1,
                contrast_floor=0.02,
                shift_y=setting.pitch / 3,
                shift_x=-setting.pitch / 4,
                rotation=rotation,
                distance_error=0.01 * setting.distance,
                stray_light=0.05,
            ),
            bayer=True,
        ),
        Sampling(
            method=method,
            reach=Reach(3, 1),
            wavelengths=1 if field else 2,
            layers=1 if field else 2,
            zones=2 if field else 1,
            step=setting.pitch / 10,
            oversampling=1.1,
            dtype=setting.dtype,
        ),
    )


def _light_matrix(setting: Setting) -> Bound:
    operator = LightOperator(_model(setting, "transfer", field=False)).to(setting.device)
    result = (*setting.scene().shape, *setting.embedding().shape)
    return Bound(lambda w: operator(w).reshape(result), setting.mask_shape, result)


def _light_embed(name: str, method: Method, *, rotation: float = 0.0, widens: str = "") -> Operator:

    def bind(setting: Setting) -> Bound:
        operator = LightOperator(_model(setting, method, field=True, rotation=rotation)).to(
            setting.device
        )
        weights = symmetric_weights(setting)
        return Bound(
            lambda scenes: operator.embed(scenes, weights),
            setting.scene().shape,
            setting.embedding().shape,
        )

    return Operator(name, bind, linear=True, batched=True, mirror=((), ()), widens=widens)


def _light_mask(setting: Setting) -> Bound:
    """From the weights of a turned mask to the measurements of two scenes, by the grid."""
    operator = LightOperator(_model(setting, "grid", field=False, rotation=0.1)).to(setting.device)
    scenes = Bound(lambda x: x, setting.scene().shape, ()).sample(setting, seed=9, batch=(2,))

    def apply(weights: Tensor) -> Tensor:
        return operator.embed(scenes, weights)

    return Bound(apply, setting.mask_shape, (2, *setting.embedding().shape))


def _measurement(setting: Setting, full_well: float, adc_bits: int = 0) -> Bound:
    conditions = Conditions(electrons=1e4, full_well=full_well, adc_bits=adc_bits, black_level=0.02)
    model = measurement_model(conditions, shot=False)
    shape = setting.embedding().shape
    return Bound(lambda values: read(model, values), shape, shape)


_BOXES = "the phases of an embedding's boxes are made, in float64, when its shape is first known"

LIGHT: tuple[Operator, ...] = (
    Operator("light, matrix", _light_matrix, mirror=((), ()), dark=False),
    _light_embed("light, embed by matrix", "transfer"),
    _light_embed("light, embed by factors", "factors"),
    _light_embed("light, embed on a grid", "grid", widens=_BOXES),
    _light_embed("light, turned mask on a grid", "grid", rotation=0.1, widens=_BOXES),
    Operator(
        "light, mask on a grid",
        _light_mask,
        # Torch cannot differentiate a sparse product forwards.
        forward=False,
        mirror=((), ()),
        dark=False,
        widens=_BOXES,
    ),
    Operator(
        "measurement, well and offset",
        # No rounding, so the gradient is the derivative.
        partial(_measurement, full_well=5e3),
        batched=True,
        dark=False,
        refuses=False,
    ),
    Operator(
        "measurement, converter",
        partial(_measurement, full_well=8e3, adc_bits=10),
        batched=True,
        smooth=False,
        dark=False,
        meta=True,
        refuses=False,
    ),
)
