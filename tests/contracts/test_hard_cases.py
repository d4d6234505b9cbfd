"""Cases that break optics code, over every operator that they can reach."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.masks import random_mask
from veilcam_optics.errors import OpticsError
from veilcam_optics.propagation import AngularSpectrum
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.grid import GridLight
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach, Variables

from .contracts import apply_one, relative
from .registry import OPERATORS
from .setting import Operator, Setting

DISTANCES = st.floats(-6, 3).map(lambda power: 10**power)
WAVELENGTHS = st.floats(-6.7, -5).map(lambda power: 10**power)

every = pytest.mark.parametrize("operator", OPERATORS, ids=lambda operator: operator.name)
of_weights = pytest.mark.parametrize(
    "operator",
    [o for o in OPERATORS if o.bind(Setting()).kind == "weights"],
    ids=lambda operator: operator.name,
)
linear = pytest.mark.parametrize(
    "operator", [o for o in OPERATORS if o.linear], ids=lambda operator: operator.name
)


def all_finite(*values: Tensor) -> bool:
    return all(
        bool(torch.isfinite(torch.view_as_real(v) if v.is_complex() else v).all()) for v in values
    )


def finite_with_gradients(operator: Operator, setting: Setting) -> None:
    """The output, and the gradient of its energy for the input and for every length."""
    lengths = {
        name: torch.tensor(setting.length(name), dtype=torch.float64, requires_grad=True)
        for name in operator.quantities
    }
    bound = operator.bind(replace(setting, variables=lengths))
    x = bound.sample(setting).requires_grad_()
    y = apply_one(operator, bound, x)
    assert all_finite(y)
    energy = (y * y.conj()).real.sum()
    gradients = torch.autograd.grad(energy, (x, *lengths.values()))
    assert all_finite(*gradients)


@pytest.mark.slow
@pytest.mark.long
@every
@settings(max_examples=max(3, settings().max_examples // 3))
@given(distance=DISTANCES, wavelength=WAVELENGTHS, narrow=st.booleans())
@example(distance=1e-6, wavelength=550e-9, narrow=True)
@example(distance=1e3, wavelength=10e-6, narrow=False)
def test_operator_is_finite_at_any_distance_and_wavelength(
    operator: Operator, distance: float, wavelength: float, narrow: bool
) -> None:
    """From a micrometre to a kilometre, from ultraviolet to thermal."""
    dtype = torch.float32 if narrow and torch.float32 in operator.dtypes else torch.float64
    setting = Setting(3, 4, dtype, distance=distance, wavelength=wavelength)
    finite_with_gradients(operator, setting)


@pytest.mark.slow
@of_weights
@pytest.mark.parametrize("openness", [0.0, 1.0])
def test_opaque_and_fully_open(operator: Operator, openness: float) -> None:
    """Zeros, and equal values, give finite results; dark stays dark."""
    setting = Setting()
    bound = operator.bind(setting)
    x = torch.full_like(bound.sample(setting), openness).requires_grad_()
    y = apply_one(operator, bound, x)
    assert all_finite(y)
    if openness == 0 and operator.dark:
        assert not bool((y != 0).any())
    else:
        assert bool((y != 0).any())
    (gradient,) = torch.autograd.grad((y * y.conj()).real.sum(), x)
    assert all_finite(gradient)


@linear
def test_zero_in_zero_out(operator: Operator) -> None:
    setting = Setting()
    bound = operator.bind(setting)
    assert float(apply_one(operator, bound, 0 * bound.sample(setting)).abs().max()) == 0


@linear
@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_very_faint_and_very_bright(operator: Operator, scale: float) -> None:
    """No hidden constant decides what counts as dark; no scene reflects more than all light."""
    setting = Setting()
    bound = operator.bind(setting)
    x = bound.sample(setting)
    if scale > 1 and operator.name.startswith(("light", "transfer, embed", "grid, embed ")):
        with pytest.raises(OpticsError, match=r"scenes hold .* outside \[0, 1\]"):
            apply_one(operator, bound, x * scale)
        return
    assert relative(
        apply_one(operator, bound, x * scale) / scale, apply_one(operator, bound, x)
    ) < (1e-13)


@pytest.mark.parametrize("quarter", [2, 4])
@pytest.mark.parametrize("dtype", [torch.complex128, torch.complex64], ids=str)
def test_wave_on_the_evanescent_edge_is_kept(quarter: int, dtype: torch.dtype) -> None:
    """s = (wavelength f)^2 is exactly 1: the wave runs along the plane and keeps its phase."""
    wavelength, n = 2.0**-20, 8
    pitch = wavelength / quarter
    frequency = n // quarter / (n * pitch)
    assert (wavelength * frequency) ** 2 == 1.0
    grid = Grid.square(n, n, pitch)
    index = torch.arange(n, dtype=torch.float64)
    wave = torch.exp(2j * torch.pi * frequency * pitch * index).expand(n, n).to(dtype)
    variables = [
        torch.tensor(value, dtype=torch.float64, requires_grad=True)
        for value in (3e-7, wavelength, pitch)
    ]
    distance, length, step = variables
    run = AngularSpectrum(padding="none", band_limit=False).prepare(
        Grid(n, n, step, step), Grid(n, n, step, step), distance, length, dtype=dtype
    )
    arrived = run(wave)
    wanted = wave * cmath.exp(-2j * math.pi * 3e-7 / wavelength)
    assert relative(arrived, wanted) < (1e-13 if dtype == torch.complex128 else 1e-6)
    probe = torch.rand(n, n, generator=torch.Generator().manual_seed(0)).to(dtype)
    gradients = torch.autograd.grad((run(probe) * wave.conj()).abs().square().sum(), variables)
    assert all_finite(*gradients)
    # The wave next to the edge is no problem either way, and the edge lies between both.
    for factor in (1 - 1e-9, 1 + 1e-9):
        near = AngularSpectrum(padding="none", band_limit=False).prepare(
            grid, grid, 3e-7, wavelength * factor, dtype=dtype
        )
        assert relative(near(wave), wanted) < 1e-3


def small_camera(distance: float = 4e-3) -> Camera:
    window, sensor = Window(rows=9, columns=4), Sensor(rows=480, columns=640)
    return Camera(window=window, sensor=sensor, distance=distance)


def test_single_pixel_embedding() -> None:
    """One number per image, by both paths, and equal to the mean of any finer embedding."""
    camera, scene = small_camera(), Scene(rows=3, columns=4, height=0.05)
    weights = random_mask(camera, torch.Generator().manual_seed(1)).double()
    picture = torch.rand(1, 3, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    light = GridLight(camera, scene, 4)
    psf = light.psf(weights)
    values = {}
    for shape in ((1, 1), (6, 8), (1, 5)):
        operator = TransferOperator(
            camera, scene, Embedding(*shape), reach=Reach(8, 3), dtype=torch.float64
        )
        values[shape] = operator.embed(picture, weights).mean()
        by_grid = light.embed(picture, psf, Embedding(*shape)).mean()
        # The grid widens every aperture by a fraction of a cell: 1.2 % at this oversampling.
        assert float(by_grid) == pytest.approx(float(values[shape]), rel=2e-2)
    assert float(values[6, 8]) == pytest.approx(float(values[1, 1]), rel=1e-4)
    assert float(values[1, 5]) == pytest.approx(float(values[1, 1]), rel=1e-4)


@pytest.mark.parametrize("brightness", [0.0, 1e-12, 1.0])
def test_constant_scenes(brightness: float) -> None:
    """A flat scene embeds in proportion to its brightness and gets the noise asked for."""
    camera, scene, embedding = small_camera(), Scene(rows=5, columns=5), Embedding(6, 8)
    operator = TransferOperator(camera, scene, embedding, dtype=torch.float64)
    weights = random_mask(camera, torch.Generator().manual_seed(1)).double()
    flat = torch.full((400, 5, 5), brightness, dtype=torch.float64)
    measurement = operator.embed(flat, weights)
    white = operator.embed(torch.ones(1, 5, 5, dtype=torch.float64), weights)
    assert relative(measurement, brightness * white.expand_as(measurement)) < 1e-13
    noisy = shot_noise(measurement, 40.0, torch.Generator().manual_seed(0))
    if brightness == 0:
        assert noisy.equal(measurement)
        return
    measured = 10 * torch.log10(measurement.square().sum() / (noisy - measurement).square().sum())
    assert float(measured) == pytest.approx(40, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dtype", "tolerance"), [(torch.bfloat16, 5e-3), (torch.float16, 1e-3)], ids=str
)
@pytest.mark.parametrize("filters", [(), (0, 1, 2)], ids=["no filters", "filters"])
@pytest.mark.parametrize("shape", [(24, 32), (3, 4)])
def test_half_precision_transfer(
    dtype: torch.dtype, tolerance: float, filters: tuple[int, ...], shape: tuple[int, int]
) -> None:
    """Kernels made in float64, then cast: what is lost is the rounding of factors and products."""
    camera = Camera(panel=Panel(filter_cycle=filters))
    scene = Scene(rows=14, columns=14)
    weights = random_mask(camera, torch.Generator().manual_seed(1)).to(dtype)
    half = TransferOperator(camera, scene, Embedding(*shape), dtype=dtype, step=6e-6)
    full = TransferOperator(camera, scene, Embedding(*shape), dtype=torch.float64, step=6e-6)
    transfer = half(weights)
    assert transfer.dtype == dtype
    assert relative(transfer.double(), full(weights.double())) < tolerance
    picture = torch.rand(2, 14, 14, generator=torch.Generator().manual_seed(2)).to(dtype)
    embedded = half.embed(picture, weights)
    assert embedded.dtype == dtype
    assert relative(embedded.double(), full.embed(picture.double(), weights.double())) < tolerance
    # A gradient that is added up over a batch in half precision is still a direction to go.
    tensors = [weights.clone().requires_grad_(), weights.double().requires_grad_()]
    for operator, values in zip((half, full), tensors, strict=True):
        torch.autograd.backward(operator.embed(picture.to(values.dtype), values).sum())
    coarse, fine = (values.grad for values in tensors)
    assert coarse is not None
    assert fine is not None
    cosine = torch.nn.functional.cosine_similarity(coarse.double().flatten(), fine.flatten(), 0)
    assert float(cosine) > 0.99


def test_learnable_distance_through_the_transfer_operator() -> None:
    """d(T)/d(distance) at 0.4 m mask to sensor, against differences of micrometres."""
    camera, scene = small_camera(distance=0.4), Scene(rows=3, columns=3, height=2e-3, distance=0.4)
    weights = random_mask(camera, torch.Generator().manual_seed(1)).double()

    def transfer(distance: Tensor) -> Tensor:
        operator = TransferOperator(
            camera,
            scene,
            Embedding(3, 4),
            reach=Reach(8, 3),
            dtype=torch.float64,
            variables=Variables(distance=distance),
        )
        return torch.as_tensor(operator(weights))

    distance = torch.tensor(0.4, dtype=torch.float64, requires_grad=True)
    probe = torch.rand(9, 12, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    (gradient,) = torch.autograd.grad((transfer(distance) * probe).sum(), distance)
    h = torch.tensor(4e-5, dtype=torch.float64)
    with torch.no_grad():
        difference = ((transfer(distance + h) - transfer(distance - h)) * probe).sum() / (2 * h)
    assert float(gradient) == pytest.approx(float(difference), rel=1e-5)
