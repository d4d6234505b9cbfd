"""Defects of other packages, where the transfer operator, plans or effects could have them too.

Those of propagation and of the grid path have tests of their own.
"""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tests.unit.optics.tensors import mask

import veilcam_optics
from veilcam_optics.apertures import remove_background
from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.masks import quantise, to_levels
from veilcam_optics.errors import OpticsError
from veilcam_optics.transfer.grid import GridLight
from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Beam, Reach

from .contracts import relative

CAMERA = Camera(window=Window(9, 4, 180, 74), sensor=Sensor(480, 640))
OPEN = replace(CAMERA, panel=Panel(filter_cycle=()))
SCENE, EMBEDDING = Scene(3, 4, 0.05), Embedding(6, 8)


def operator(
    camera: Camera = CAMERA,
    *,
    reach: Reach = Reach(1, 0),  # noqa: B008 - frozen
    step: float = 1.55e-6,
    **options: Any,
) -> TransferOperator:
    return TransferOperator(
        camera, SCENE, EMBEDDING, reach=reach, step=step, dtype=torch.float64, **options
    )


def modules() -> list[Path]:
    found = sorted(Path(next(iter(veilcam_optics.__path__))).rglob("*.py"))
    assert len(found) > 20
    return found


@pytest.mark.parametrize("path", modules(), ids=lambda path: path.stem)
def test_no_function_swallows_a_misspelt_option(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            assert node.args.kwarg is None, f"line {node.lineno}"


def test_each_colour_has_its_own_wavelength() -> None:
    """Red's matrix is that of a camera all of whose light is red, and so on."""
    colours = operator(OPEN, reach=Reach(8, 3), colour=True)(mask(CAMERA))
    for channel, wavelength in enumerate(OPEN.wavelengths):
        alone = replace(OPEN, wavelengths=(wavelength, wavelength, wavelength))
        same = operator(alone, reach=Reach(8, 3), colour=True)(mask(CAMERA))
        assert relative(colours[channel], same[0]) < 1e-13
        assert relative(same[0], same[2]) < 1e-13
    assert relative(colours[0], colours[2]) > 1e-3


def test_dim_mask_stays_dim() -> None:
    light = operator()
    assert relative(light(mask(CAMERA) / 2), light(mask(CAMERA)) / 4) < 1e-13
    half = to_levels(torch.full(CAMERA.mask_shape, 0.5), Panel())
    assert set(half.flatten().tolist()) == {32}


@pytest.mark.parametrize(("value", "outside"), [(1e-6, -0.5), (1.0, 1.5)])
def test_weights_at_the_ends_do_not_die(value: float, outside: float) -> None:
    """Clipped inside, they would get no gradient and never come back; outside is refused."""
    weights = mask(CAMERA)
    weights[2, 1] = outside
    with pytest.raises(OpticsError, match=r"weights hold 1 values outside \[0, 1\]"):
        operator()(weights)
    weights[2, 1] = value
    weights.requires_grad_()
    (gradient,) = torch.autograd.grad(operator()(weights).square().sum(), weights)
    assert float(gradient[2, 1].abs()) > 0
    (gradient,) = torch.autograd.grad(quantise(weights, Panel()).sum(), weights)
    assert float(gradient[2, 1]) == 1


def test_six_bits_of_the_wire_are_modelled() -> None:
    """A panel of 64 levels shows another mask than one of 2, and an embedding tells."""
    weights, light = mask(CAMERA), operator()
    exact = light(weights)
    errors = [
        relative(light(quantise(weights, replace(Panel(), levels=levels))), exact)
        for levels in (2, 8, 64, 4096)
    ]
    assert errors == sorted(errors, reverse=True)
    assert 1e-4 < errors[2] < 5e-2


@pytest.mark.parametrize("rows", [5, 6])
@pytest.mark.parametrize("columns", [7, 8])
def test_odd_sizes_are_not_shifted_by_a_pixel(rows: int, columns: int) -> None:
    """A symmetric mask gives a symmetric embedding of a white scene, whatever the parities."""
    light = TransferOperator(
        OPEN, SCENE, Embedding(rows, columns), reach=Reach(8, 3), dtype=torch.float64
    )
    weights = mask(CAMERA)
    weights = weights + weights.flip(0)
    weights = (weights + weights.flip(1)) / 4
    values = light.embed(torch.ones(1, *SCENE.shape, dtype=torch.float64), weights)[0]
    assert relative(values.flip(0), values) < 1e-12
    assert relative(values.flip(1), values) < 1e-12


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("reach.rows", operator(OPEN, reach=Reach(2, 0))),
        ("reach.columns", operator(OPEN, reach=Reach(1, 1))),
        ("step", operator(OPEN, step=6e-6)),
        ("beams", operator(OPEN, beams=[Beam(channel, 500e-9) for channel in range(3)])),
        ("beam distance", operator(OPEN, beams=[Beam(c, 550e-9, 1.0, 0.3) for c in range(3)])),
        (
            "beam stretch",
            operator(OPEN, beams=[Beam(c, 550e-9, 1.0, None, (1.2, 1.3)) for c in range(3)]),
        ),
        ("shadow", operator(OPEN, approximation=Approximation(shadow=True))),
        ("plane wave", operator(OPEN, approximation=Approximation(plane_wave=True))),
        ("point binning", operator(OPEN, approximation=Approximation(point_binning=True))),
        ("filters", operator(CAMERA)),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_every_option_of_the_transfer_operator_does_something(
    name: str, changed: TransferOperator
) -> None:
    """An absorbing boundary that absorbs nothing is an option that lies."""
    base = operator(OPEN)(mask(CAMERA))
    assert relative(changed(mask(CAMERA)), base) > 1e-6, name


def test_every_option_of_the_other_paths_does_something() -> None:
    scenes = torch.rand(1, 3, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    by_grid = []
    for oversampling in (1.0, 2.0):
        light = GridLight(CAMERA, SCENE, oversampling)
        by_grid.append(light.embed(scenes, light.psf(mask(CAMERA)), EMBEDDING))
    assert relative(*by_grid) > 1e-4
    image = torch.rand(40, 40, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    image[15:25, 15:25] += 5
    cleaned = remove_background(image)
    assert relative(remove_background(image, margin=0.2), cleaned) > 1e-3
    assert relative(remove_background(image, deviations=0.5), cleaned) > 1e-3


def test_secrets_stay_out_of_refusals() -> None:
    weights = mask(CAMERA)
    weights[0, 0] = float("nan")
    for wrong in (weights, mask(CAMERA).mT):
        with pytest.raises(OpticsError) as refusal:
            operator()(wrong)
        told = str(refusal.value)
        assert not any(f"{float(w):.4g}" in told for w in wrong.flatten())
