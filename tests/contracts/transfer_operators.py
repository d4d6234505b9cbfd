"""The transfer operator and what it is made of: factored fields, kernels."""

from __future__ import annotations

import torch
from torch import Tensor

from veilcam_optics.decoding import Precision, SceneDecoding
from veilcam_optics.decoding.statistics import SceneStatistics
from veilcam_optics.transfer.factored import aperture_fields, fresnel_integral
from veilcam_optics.transfer.kernels import EXACT, Approximation, box_kernel, double_integral
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Beam, Reach, Variables

from .setting import LENGTHS, Bound, Operator, Setting, centred, symmetric_weights

NEAR, WIDE = Reach(1, 0), Reach(4, 2)


def _transfer(
    setting: Setting, *, filters: bool, leakage: float, reach: Reach, colour: bool
) -> TransferOperator:
    distance, pitch = setting.variables.get("distance"), setting.variables.get("pitch")
    wavelength = setting.variables.get("wavelength")
    ratios = torch.tensor([1.1, 1.0, 0.9], dtype=torch.float64)
    return TransferOperator(
        setting.camera(filters=filters, leakage=leakage),
        setting.scene(),
        setting.embedding(),
        reach=reach,
        step=setting.pitch / 10,
        colour=colour,
        dtype=setting.dtype,
        variables=Variables(
            distance=distance,
            wavelengths=None if wavelength is None else ratios * wavelength,
            pitch_y=None if pitch is None else 2 * pitch,
            pitch_x=None if pitch is None else 3 * pitch,
        ),
    ).to(setting.device)


def _transfer_matrix(
    name: str,
    *,
    filters: bool = False,
    leakage: float = 0.0,
    reach: Reach = NEAR,
    colour: bool = False,
) -> Operator:
    """From weights to T, as (scene rows, scene columns, embedding rows, embedding columns)."""

    def bind(setting: Setting) -> Bound:
        operator = _transfer(setting, filters=filters, leakage=leakage, reach=reach, colour=colour)
        channels = (3,) if colour else ()
        result = (*channels, *setting.scene().shape, *setting.embedding().shape)
        return Bound(lambda w: operator(w).reshape(result), setting.mask_shape, result)

    return Operator(
        name, bind, quantities=LENGTHS, mirror=((), (-3, -1)) if filters else ((-4, -2), (-3, -1))
    )


def _transfer_embed(name: str, *, colour: bool) -> Operator:

    def bind(setting: Setting) -> Bound:
        operator = _transfer(setting, filters=True, leakage=0.1, reach=Reach(3, 1), colour=colour)
        weights = symmetric_weights(setting)
        channels = (3,) if colour else ()

        def apply(scenes: Tensor) -> Tensor:
            return operator.embed(scenes, weights)

        result = (*channels, *setting.embedding().shape)
        return Bound(apply, (*channels, *setting.scene().shape), result)

    return Operator(name, bind, linear=True, batched=True, quantities=LENGTHS, mirror=((), (-1,)))


def _transfer_by_factors(setting: Setting) -> Bound:
    operator = _transfer(setting, filters=True, leakage=0.1, reach=WIDE, colour=True)
    weights = symmetric_weights(setting)
    return Bound(
        lambda scenes: operator.embed_by_factors(scenes, weights),
        (3, *setting.scene().shape),
        (3, *setting.embedding().shape),
    )


def _decoder(setting: Setting) -> Bound:
    """From measurements to scenes, behind one mask (affine)."""
    operator = _transfer(setting, filters=False, leakage=0.0, reach=NEAR, colour=False)
    pixels = setting.rows * setting.columns
    generator = torch.Generator().manual_seed(7)
    mean, basis, residual = (
        0.1 + torch.rand(shape, generator=generator, dtype=torch.float64)
        for shape in ((pixels,), (pixels, 6), (pixels,))
    )
    statistics = SceneStatistics(mean, basis, residual)
    decoding = SceneDecoding(operator, statistics, precision=Precision.DOUBLE)
    decoder = decoding.prepare(symmetric_weights(setting))
    return Bound(decoder, setting.embedding().shape, setting.scene().shape)


def _transfer_variant(
    name: str, *, beams: bool = False, approximation: Approximation = EXACT
) -> Operator:

    def bind(setting: Setting) -> Bound:
        light = [
            Beam(channel, wavelength * factor, share, 45 * setting.distance, (1.1, 1.2))
            for channel, wavelength in enumerate(setting.camera().wavelengths)
            for factor, share in ((1.0, 0.7), (1.05, 0.3))
        ]
        operator = TransferOperator(
            setting.camera(),
            setting.scene(),
            setting.embedding(),
            reach=WIDE,
            step=setting.pitch / 10,
            dtype=setting.dtype,
            beams=light if beams else None,
            approximation=approximation,
        ).to(setting.device)
        result = (*setting.scene().shape, *setting.embedding().shape)
        return Bound(lambda w: operator(w).reshape(result), setting.mask_shape, result)

    return Operator(name, bind, mirror=((-4, -2), (-3, -1)))


def _factored_field(setting: Setting) -> Bound:
    pitch = setting.length("pitch")
    spread = []
    for apertures, points in zip(
        setting.mask_shape, (2 * setting.rows + 1, 2 * setting.columns), strict=True
    ):
        spread.append(
            aperture_fields(
                centred(points, setting) * setting.pitch * 1.3,
                centred(apertures, setting) * 2 * pitch,
                1.6 * pitch,
                wavelength=setting.length("wavelength"),
                source_distance=50 * setting.distance,
                distance=setting.length("distance"),
            ).to(setting.complex_dtype)
        )
    rows, columns = spread
    return Bound(
        lambda w: rows @ w @ columns.mT,
        setting.mask_shape,
        (rows.shape[0], columns.shape[0]),
        kind="field",
    )


def _fresnel(setting: Setting) -> Bound:
    shape = (setting.rows, setting.columns)
    return Bound(fresnel_integral, shape, shape, kind="signed")


def _double_integral(setting: Setting) -> Bound:
    samples, points = setting.rows + 2, setting.columns
    at = torch.linspace(0.05, 0.95, points, dtype=setting.dtype, device=setting.device)
    return Bound(
        lambda values: double_integral(values, 0.0, 1 / (samples - 1), at),
        (samples, 3),
        (points, 3),
        kind="signed",
    )


def _box_kernel(setting: Setting) -> Bound:
    nodes, offsets = 4 * setting.rows + 21, setting.columns
    at = centred(offsets, setting).to(setting.dtype) / (2 * offsets)

    def apply(products: Tensor) -> Tensor:
        start, step = -1.0, 2 / (nodes - 1)
        return box_kernel(at, products, start, step, pixel=0.3, image=0.2)

    return Bound(apply, (nodes, 3), (offsets, 3), kind="signed")


TRANSFER: tuple[Operator, ...] = (
    _transfer_matrix("transfer, gray"),
    _transfer_matrix("transfer, gray, filters", filters=True),
    _transfer_matrix(
        "transfer, gray, leaky filters, wide reach", filters=True, leakage=0.1, reach=WIDE
    ),
    _transfer_matrix("transfer, gray, wide reach", reach=WIDE),
    _transfer_matrix("transfer, colour, wide reach", reach=WIDE, colour=True),
    _transfer_embed("transfer, embed gray", colour=False),
    _transfer_embed("transfer, embed colour", colour=True),
    Operator(
        "transfer, embed by factors",
        _transfer_by_factors,
        linear=True,
        batched=True,
        mirror=((), (-1,)),
    ),
    _transfer_variant("transfer, several beams", beams=True),
    _transfer_variant("transfer, shadows", approximation=Approximation(shadow=True)),
    _transfer_variant("transfer, plane wave", approximation=Approximation(plane_wave=True)),
    _transfer_variant("transfer, point binning", approximation=Approximation(point_binning=True)),
    Operator(
        "decoder", _decoder, batched=True, dtypes=(torch.float64,), mirror=((), ()), dark=False
    ),
    Operator(
        "factored field",
        _factored_field,
        linear=True,
        batched=True,
        quantities=LENGTHS,
        refuses=False,
    ),
    Operator(
        "Fresnel integral",
        _fresnel,
        batched=True,
        dtypes=(torch.float64,),
        refuses=False,
        forward=False,
    ),
    Operator(
        "double integral", _double_integral, linear=True, mirror=((), ()), meta=True, refuses=False
    ),
    Operator("box kernel", _box_kernel, linear=True, mirror=((-2,), ()), meta=True, refuses=False),
)
