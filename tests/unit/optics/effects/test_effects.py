"""Effects: each changes the output where it matters, and is off where it does not."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
import torch
from tests.unit.optics.tensors import bare, mask, relative
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import IDEAL, Conditions, Imperfections
from veilcam_optics.effects import EFFECTS, Effect, Model, Sampling
from veilcam_optics.effects.base import Assessment
from veilcam_optics.effects.light import Zone
from veilcam_optics.effects.model import Method
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan import plan
from veilcam_optics.plan.cost import pairs
from veilcam_optics.plan.errors import ErrorModel
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.simulation.rotated_mask import RotatedMask
from veilcam_optics.transfer.field_angle import fading, scene_tangents
from veilcam_optics.transfer.grid import FEWEST_CELLS, cells_in_aperture
from veilcam_optics.transfer.kernels import shadow_kernel
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach

BARE = Panel(filter_cycle=())
CAMERA = Camera(panel=BARE, window=Window(12, 6), sensor=Sensor(rows=801, columns=960))
SCENE = Scene(5, 4, height=0.06)
EMBEDDING = Embedding(6, 7)


@dataclass(frozen=True)
class Called:
    """A job that calls for an effect: ignoring it costs at least ``least``."""

    conditions: Conditions = IDEAL
    panel: Panel = BARE
    embedding: Embedding = EMBEDDING
    tolerance: float = 1e-3
    least: float = 2e-3
    camera: Camera = CAMERA
    method: Method = "transfer"
    sampling: Mapping[str, object] = field(default_factory=dict)
    """In the place of what others are looked at with."""


FINE = bare(3e-6, 3e-6)
LEAKY = Panel(filter_leakage=0.2)
COUNTED = Conditions(electrons=1e5)

CALLED = {
    "diffraction": Called(),
    "non-paraxial diffraction": Called(
        panel=FINE,
        camera=Camera(window=Window(6, 6), sensor=Sensor(16, 16, 1.5e-6), distance=40e-6),
        method="grid",
        # Fine enough that nothing else tells the two apart.
        sampling={"reach": Reach(5, 5), "step": 1e-7, "oversampling": 80.0},
    ),
    "spherical wavefront": Called(),
    "dead space": Called(),
    "neighbour interference": Called(embedding=Embedding(24, 32)),
    "colour filters": Called(panel=Panel()),
    "filter leakage": Called(panel=LEAKY),
    "spectrum per channel": Called(
        Conditions(bandwidth=(90e-9,) * 3),
        embedding=Embedding(60, 70),
        tolerance=1e-4,
        least=1.5e-4,
    ),
    "depth layers": Called(Conditions(depth_range=0.1)),
    "field angle": Called(),
    "mask quantisation": Called(Conditions(levels=16)),
    "mask gamma": Called(Conditions(imperfections=Imperfections(gamma=1.1))),
    "contrast floor": Called(Conditions(imperfections=Imperfections(contrast_floor=0.05))),
    "dead lines": Called(
        Conditions(imperfections=Imperfections(dead_rows=(1,), dead_columns=(0,)))
    ),
    "mask shift": Called(Conditions(imperfections=Imperfections(shift_y=1e-5, shift_x=-2e-5))),
    "mask rotation": Called(Conditions(imperfections=Imperfections(rotation=10e-3))),
    "distance error": Called(Conditions(imperfections=Imperfections(distance_error=5e-5))),
    "stray light": Called(Conditions(imperfections=Imperfections(stray_light=0.05))),
    "pixel binning": Called(),
    "Bayer pattern": Called(Conditions(bayer=True), panel=Panel(), embedding=Embedding(61, 70)),
    "shot noise": Called(COUNTED),
    "read noise": Called(replace(COUNTED, read_noise=100.0)),
    "full well": Called(replace(COUNTED, full_well=1e4)),
    "black level": Called(Conditions(black_level=0.01)),
    "ADC": Called(Conditions(adc_bits=4)),
}


def scenes(count: int = 3, scene: Scene = SCENE) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return torch.rand(count, *scene.shape, generator=generator, dtype=torch.float64)


def model_of(called: Called, **sampling: object) -> Model:
    camera = replace(called.camera, panel=called.panel)
    settings = {
        "method": called.method,
        "reach": Reach(3, 1),
        "wavelengths": 3,
        "layers": 3,
        "dtype": torch.float64,
        "oversampling": max(2.0, 2 * FEWEST_CELLS / cells_in_aperture(camera)),
    }
    return Model(
        camera,
        SCENE,
        called.embedding,
        called.conditions,
        Sampling(**{**settings, **called.sampling, **sampling}),  # type: ignore[arg-type]
    )


def measurements(model: Model, pictures: Tensor | None = None) -> Tensor:
    generator = torch.Generator().manual_seed(2)
    used = scenes() if pictures is None else pictures
    return LightOperator(model).embed(used, mask(model.camera), generator)


def test_every_effect_has_a_job_that_calls_for_it() -> None:
    assert [effect.name for effect in EFFECTS] == list(CALLED)


@pytest.mark.thorough
@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_effect_changes_the_output_where_it_matters(effect: Effect) -> None:
    called = CALLED[effect.name]
    model = model_of(called, zones=2)
    # The light is judged by its transfer, one scene pixel lit at a time; the sensor by bright ones.
    points = torch.eye(20, dtype=torch.float64).reshape(20, *SCENE.shape)
    white = torch.ones(2, *SCENE.shape, dtype=torch.float64)
    pictures = white if effect.name in OF_THE_SENSOR else points
    found = relative(measurements(effect.without(model), pictures), measurements(model, pictures))
    assert effect.present(model)
    assert found > called.least
    estimated = effect.error(
        ErrorModel(model_of(called, wavelengths=1, layers=1), called.tolerance)
    )
    # One small mask, and the mean over many.
    assert found / 2.5 < estimated < found * 2.5


@pytest.mark.thorough
@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_effect_is_on_in_a_plan_where_it_matters(effect: Effect) -> None:
    called = CALLED[effect.name]
    camera = replace(called.camera, panel=called.panel)
    chosen = plan(
        camera,
        SCENE,
        called.embedding,
        called.tolerance,
        called.conditions,
        method=called.method if called.method == "grid" else None,
    )
    found = {each.name: each for each in chosen.assessments}[effect.name]
    assert found.matters
    assert found.error > called.tolerance / 10
    assert found.reason in " ".join(chosen.explain().split()) or len(found.reason) > 60


OF_THE_SENSOR = {"Bayer pattern", "shot noise", "read noise", "full well", "ADC", "black level"}

ALWAYS = {
    "diffraction",
    "non-paraxial diffraction",
    "spherical wavefront",
    "dead space",
    "neighbour interference",
    "field angle",
    "pixel binning",
}


@pytest.fixture(scope="module")
def ordinary() -> dict[str, Assessment]:
    return {found.name: found for found in plan(CAMERA, SCENE, EMBEDDING, 1e-2).assessments}


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_effect_is_off_in_an_ordinary_scene(
    ordinary: dict[str, Assessment], effect: Effect
) -> None:
    """What conditions would have to call for is off; what is always there has tests of its own."""
    found = ordinary[effect.name]
    if effect.name in ALWAYS:
        assert found.error > 0
    else:
        assert not found.matters
        assert found.error == 0
        assert found.cost_ms == 0
        assert found.reason == effect.absent


@pytest.mark.parametrize(
    ("name", "camera", "scene", "embedding", "tolerance"),
    [
        ("diffraction", replace(CAMERA, distance=20e-6), SCENE, Embedding(3, 4), 5e-2),
        ("non-paraxial diffraction", CAMERA, SCENE, EMBEDDING, 1e-3),
    ],
)
def test_effect_that_takes_time_is_off_where_it_hardly_shows(
    name: str, camera: Camera, scene: Scene, embedding: Embedding, tolerance: float
) -> None:
    chosen = plan(camera, scene, embedding, tolerance)
    found = {assessment.name: assessment for assessment in chosen.assessments}[name]
    assert not found.matters
    assert 0 < found.error <= tolerance
    assert chosen.reached


@pytest.mark.parametrize("tolerance", [1e-2, 0.5])
def test_effects_that_take_no_time_stay_on(tolerance: float) -> None:
    chosen = plan(CAMERA, Scene(5, 4, 300.0, 1000.0), EMBEDDING, tolerance)
    on = {found.name for found in chosen.assessments if found.matters}
    free = {"diffraction", "spherical wavefront", "dead space", "field angle", "pixel binning"}
    assert free <= on


@pytest.mark.slow
def test_effects_that_are_off_are_not_computed() -> None:
    """The plan of an ordinary scene holds what the plain operator holds, and not a number more."""
    chosen = plan(CAMERA, SCENE, EMBEDDING, 1e-3)
    plain = TransferOperator(CAMERA, SCENE, EMBEDDING, reach=chosen.model.sampling.reach)
    held = sum(
        buffer.numel() for name, buffer in chosen.operator.named_buffers() if "zones" in name
    )
    assert held == sum(buffer.numel() for buffer in plain.buffers())
    demanding = Conditions(bandwidth=(80e-9,) * 3, depth_range=0.2)
    more = plan(CAMERA, SCENE, EMBEDDING, 1e-4, demanding)
    assert pairs(more.model)[1] > pairs(chosen.model)[1]
    assert more.cost.step_ms > chosen.cost.step_ms


@pytest.mark.thorough
@pytest.mark.parametrize("method", ["factors", "grid"])
def test_methods_agree_under_all_linear_conditions(method: str) -> None:
    conditions = Conditions(
        bandwidth=(20e-9, 0.0, 30e-9),
        depth_range=0.1,
        imperfections=Imperfections(
            gamma=1.1,
            contrast_floor=0.05,
            shift_y=1e-5,
            shift_x=-2e-5,
            rotation=3e-3,
            distance_error=1e-4,
            stray_light=0.05,
        ),
        bayer=True,
    )
    called = Called(conditions, panel=LEAKY)
    sampling = {"zones": 2, "wavelengths": 2, "layers": 2, "oversampling": 2.0}
    by_matrix = measurements(model_of(called, **sampling))
    other = measurements(model_of(called, method=method, **sampling))
    assert relative(other, by_matrix) < (1e-12 if method == "factors" else 4e-2)


def test_transfer_and_embedding_agree_and_pass_gradients() -> None:
    conditions = Conditions(
        imperfections=Imperfections(gamma=1.2, stray_light=0.1), bayer=True, levels=64
    )
    operator = LightOperator(model_of(Called(conditions, panel=LEAKY), zones=2))
    weights = mask(CAMERA).requires_grad_()
    embedded = operator.embed(scenes(), weights)
    by_matrix = scenes().flatten(1) @ operator(weights.detach())
    assert relative(by_matrix, embedded.detach().flatten(1)) < 1e-12
    (gradient,) = torch.autograd.grad(embedded.square().sum(), weights)
    assert bool(torch.isfinite(gradient).all())
    assert int((gradient == 0).sum()) == 0


def test_dark_mask_keeps_a_finite_gradient_under_gamma() -> None:
    operator = LightOperator(model_of(Called(Conditions(imperfections=Imperfections(gamma=0.5)))))
    weights = torch.zeros(CAMERA.mask_shape, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(operator.embed(scenes(), weights).sum(), weights)
    assert bool(torch.isfinite(gradient).all())


@pytest.mark.slow
def test_spectrum_is_an_average_over_wavelengths() -> None:
    conditions = Conditions(bandwidth=(60e-9,) * 3)
    called = Called(conditions, embedding=Embedding(60, 70))
    deviation = 60e-9 / 2.3548
    total, weight = torch.zeros(20, 4200, dtype=torch.float64), 0.0
    for step in range(-12, 13):
        away = step / 4
        red, green, blue = (length + away * deviation for length in CAMERA.wavelengths)
        camera = replace(CAMERA, wavelengths=(red, green, blue))
        share = math.exp(-(away**2) / 2)
        operator = TransferOperator(
            camera, SCENE, called.embedding, reach=Reach(1, 0), dtype=torch.float64
        )
        total, weight = total + share * operator(mask(CAMERA)), weight + share
    models = (model_of(called, wavelengths=count, reach=Reach(1, 0)) for count in (1, 2, 4))
    errors = [relative(LightOperator(one)(mask(CAMERA)), total / weight) for one in models]
    assert errors[0] > 3 * errors[1]
    assert errors[2] < 1e-4


@pytest.mark.slow
def test_depth_is_an_average_over_distances() -> None:
    called = Called(Conditions(depth_range=0.12))
    total = torch.zeros(20, 42, dtype=torch.float64)
    for layer in range(60):
        distance = SCENE.distance + 0.12 * ((layer + 0.5) / 60 - 0.5)
        operator = TransferOperator(
            CAMERA,
            replace(SCENE, distance=distance),
            EMBEDDING,
            reach=Reach(1, 0),
            step=4e-6,
            dtype=torch.float64,
        )
        total = total + operator(mask(CAMERA)) / 60
    models = (model_of(called, layers=n, reach=Reach(1, 0), step=4e-6) for n in (1, 3, 5))
    errors = [relative(LightOperator(one)(mask(CAMERA)), total) for one in models]
    assert errors[0] > 1e-2
    assert errors[2] < errors[1] < errors[0] / 3
    assert errors[2] < 2e-3


def test_oblique_light_spreads_as_the_distance_bends() -> None:
    """The stretch is the second derivative of the true distance against the paraxial one."""
    d, ty, tx = 1.0, 0.35, -0.2
    zone = Zone(slice(0, 1), slice(0, 1), ty, tx)

    def far(y: float, x: float) -> float:
        return math.sqrt(d**2 + (ty * d - y) ** 2 + (tx * d - x) ** 2)

    h = 1e-4
    bend_y = (far(h, 0) + far(-h, 0) - 2 * far(0, 0)) / h**2
    bend_x = (far(0, h) + far(0, -h) - 2 * far(0, 0)) / h**2
    assert zone.stretch == pytest.approx((1 / (d * bend_y), 1 / (d * bend_x)), rel=1e-6)


@pytest.mark.parametrize("height", [1e-200, 3e-5, 1e-3, 0.3, 3.0])
def test_field_fades_with_the_fourth_power_of_the_cosine(height: float) -> None:
    """Its mean over a pixel, also of pixels of a few tens of microradians and of a wide field."""
    scene = replace(SCENE, height=height)
    kept, (y, x) = fading(scene), scene_tangents(scene)
    half = scene.pixel / scene.distance / 2
    nodes, shares = np.polynomial.legendre.leggauss(40)
    cosines = (1 + (y[0] + half * nodes[:, None]) ** 2 + (x[1] + half * nodes) ** 2) ** -2
    # A middle is half the square of a side off, at most 5e-9; edges round at 1e-16 over it.
    assert kept[0, 1] == pytest.approx(float(shares @ cosines @ shares) / 4, rel=2e-8)


def test_oblique_light_is_fainter_on_the_far_side_of_the_mask() -> None:
    """Of two sub-pixels alone, the light is that of the way to each: the cube of the cosine."""
    camera = replace(CAMERA, window=Window(41, 1))
    scene = Scene(2, 1, height=0.4, distance=0.2)
    sampling = Sampling(reach=Reach(0, 0), step=1e-6, dtype=torch.float64)
    oblique = Model(camera, scene, Embedding(1, 1), IDEAL, sampling)
    axial = replace(oblique, sampling=replace(sampling, oblique=False))
    cubes, lights = [], []
    for row in (0, 40):
        alone = torch.zeros(camera.mask_shape, dtype=torch.float64)
        alone[row] = 1
        cubes.append(math.hypot(1, (0.1 - camera.row_centres[row]) / 0.2) ** -3)
        light = LightOperator(oblique)(alone)[1] / LightOperator(axial)(alone)[1]
        lights.append(float(light))
    assert lights[1] / lights[0] == pytest.approx(cubes[1] / cubes[0], rel=2e-4)
    assert abs(cubes[1] / cubes[0] - 1) > 5e-3


def test_zones_cut_the_field_without_a_seam() -> None:
    """Where nothing depends on the angle, many zones are as good as one."""
    # With depth: every layer of a zone has its own place in the image.
    model = model_of(Called(Conditions(depth_range=0.2)), layers=2)
    axial = [
        replace(model, scene=replace(SCENE, height=1e-6 * SCENE.height)).with_sampling(zones=zones)
        for zones in (1, 3)
    ]
    one, many = (measurements(each) for each in axial)
    assert relative(many, one) < 1e-7


def test_small_rotation_against_every_sub_pixel_on_its_own() -> None:
    angle, camera = 1e-2, replace(CAMERA, window=Window(7, 4))
    sampling = Sampling(reach=Reach(0, 0), step=3e-6, dtype=torch.float64)
    straight = Model(camera, SCENE, EMBEDDING, IDEAL, sampling)
    turned = replace(straight, conditions=Conditions(imperfections=Imperfections(rotation=angle)))
    total = torch.zeros(3, *EMBEDDING.shape, dtype=torch.float64)
    for row, y in enumerate(camera.row_centres):
        for column, x in enumerate(camera.column_centres):
            alone = torch.zeros(camera.mask_shape, dtype=torch.float64)
            alone[row, column] = mask(camera)[row, column]
            moved = Conditions(imperfections=Imperfections(shift_y=angle * x, shift_x=-angle * y))
            total += LightOperator(replace(straight, conditions=moved)).embed(scenes(), alone)
    assert relative(measurements(straight), total) > 3e-3
    assert relative(measurements(turned), total) < 3e-4


def test_turned_mask_lets_the_same_power_through() -> None:
    weights = mask(CAMERA)
    panel = CAMERA.panel
    power = float(weights.square().sum()) * panel.aperture_y * panel.aperture_x
    for angle in (0.0, 0.3, -1.2):
        turned = RotatedMask(
            CAMERA, 9e-6, rotation=angle, shift_y=2e-5, shift_x=0.0, dtype=torch.float64
        )
        found = float(turned(weights).square().sum()) * 9e-6**2
        assert found == pytest.approx(power, rel=2e-2)


def test_quarter_turn_of_a_square_panel_is_a_turned_array() -> None:
    panel = Panel(pitch_y=80e-6, pitch_x=80e-6, aperture_y=60e-6, aperture_x=60e-6)
    camera = Camera(panel=panel, window=Window(4, 4))
    straight, turned = (
        RotatedMask(camera, 10e-6, rotation=angle, shift_y=0, shift_x=0, dtype=torch.float64)
        for angle in (0.0, math.pi / 2)
    )
    weights = mask(camera)
    # From x towards y, y pointing to higher rows: columns become rows.
    assert relative(turned(weights), straight(weights.T.flip(1).contiguous())) < 1e-6


def test_shadow_kernel_equals_a_dense_integral() -> None:
    offsets = torch.linspace(-1e-3, 1e-3, 21, dtype=torch.float64)
    low = torch.tensor([-0.3e-3, 0.1e-3], dtype=torch.float64)
    high = torch.tensor([-0.1e-3, 0.4e-3], dtype=torch.float64)
    nodes = torch.arange(-2e-3, 2e-3, 1e-6, dtype=torch.float64) + 0.5e-6
    kappa = ((196e-6 + 43e-6) / 2 - (offsets[:, None] - nodes).abs()).clamp(0, 43e-6)
    inside = (nodes[:, None] > low) & (nodes[:, None] < high)
    dense = kappa @ inside.double() * 1e-6
    assert relative(shadow_kernel(offsets, low, high, pixel=196e-6, image=43e-6), dense) < 1e-3


def test_measured_filters_take_the_place_of_leakage() -> None:
    table = ((0.9, 0.1, 0.0), (0.2, 0.8, 0.1), (0.0, 0.3, 0.7))
    camera = replace(CAMERA, panel=Panel(filter_leakage=0.5, filter_amplitudes=table))
    assert camera.row_amplitudes(1)[:3] == (0.1, 0.8, 0.3)
    leaky = replace(CAMERA, panel=Panel(filter_leakage=0.5))
    assert leaky.row_amplitudes(1)[:3] == (0.5, 1.0, 0.5)
    with pytest.raises(OpticsError, match="filter_amplitudes"):
        Panel(filter_amplitudes=((1.0, 0.0, 0.0),))


def fitted(**changes: Any) -> Model:
    return Model(CAMERA, SCENE, EMBEDDING, Conditions(**changes))


@pytest.mark.parametrize(
    ("made", "changes", "message"),
    [
        (Conditions, {"depth_range": -0.1}, r"conditions.depth_range = -0.1 m"),
        (Conditions, {"bandwidth": (1e-8, math.nan, 1e-8)}, r"conditions.bandwidth\[G\] = nan m"),
        (Conditions, {"levels": 1}, "conditions.levels = 1"),
        (Conditions, {"levels": 2.5}, "conditions.levels = 2.5"),
        (Conditions, {"adc_bits": 99}, "conditions.adc_bits = 99"),
        (Conditions, {"snr_db": math.nan}, "conditions.snr_db = nan dB"),
        (Conditions, {"read_noise": 3.0}, "conditions.electrons = 0"),
        (Conditions, {"electrons": 1e3, "snr_db": 40.0}, "conditions.snr_db = 40.0 dB"),
        (Imperfections, {"gamma": 0.0}, "imperfections.gamma = 0.0"),
        (Imperfections, {"stray_light": 2.0}, "imperfections.stray_light = 2.0"),
        (Imperfections, {"rotation": math.inf}, "imperfections.rotation = inf rad"),
        (Imperfections, {"shift_y": math.inf}, "imperfections.shift_y = inf m"),
        (Imperfections, {"contrast_floor": 1.0}, "imperfections.contrast_floor = 1.0"),
        (Imperfections, {"dead_transmittance": 1.5}, "imperfections.dead_transmittance = 1.5"),
        (fitted, {"bandwidth": (5e-7, 0, 0)}, "at most half the wavelength"),
        (fitted, {"depth_range": 1.0}, "at most the scene's distance"),
        (fitted, {"imperfections": Imperfections(distance_error=-4e-3)}, "more than minus the"),
        (fitted, {"imperfections": Imperfections(dead_rows=(99,))}, "dead_rows = 99"),
        (Sampling, {"method": "magic"}, "sampling.method"),
        (Sampling, {"wavelengths": 0}, "sampling.wavelengths = 0"),
        (Sampling, {"step": -1.0}, "sampling.step = -1.0 m"),
        (Sampling, {"dtype": torch.float16}, "sampling.dtype"),
    ],
)
def test_impossible_settings_are_named(
    made: Callable[..., object], changes: dict[str, object], message: str
) -> None:
    with pytest.raises(OpticsError, match=message):
        made(**changes)


def test_wrong_shapes_are_named() -> None:
    operator = LightOperator(model_of(Called()))
    with pytest.raises(OpticsError, match=r"scenes.shape = \(1, 2, 2\)"):
        operator.embed(torch.ones(1, 2, 2), mask(CAMERA))
    with pytest.raises(OpticsError, match=r"weights.shape = \(2, 2\)"):
        operator(torch.ones(2, 2))
    grid = LightOperator(model_of(Called(), method="grid", oversampling=0.5))
    with pytest.raises(OpticsError, match="forms no transfer matrix"):
        grid(mask(CAMERA))
