"""Plans: honest, total, cheap where they can be, and clear about why."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest
import torch
from benchmarks.accuracy.reference import reference_transfer
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.unit.optics.tensors import axial, bare, mask, relative
from typer.testing import CliRunner

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import IDEAL, Conditions, Imperfections
from veilcam_optics.cli.main import app
from veilcam_optics.effects import EFFECTS, Model, Sampling
from veilcam_optics.effects.model import Method
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan import Plan, plan
from veilcam_optics.plan.cost import cost
from veilcam_optics.plan.search import MAX_NUMBERS
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach

BARE = Panel(filter_cycle=())
CAMERA = Camera(panel=BARE, window=Window(12, 6), sensor=Sensor(rows=500, columns=600))
SCENE = Scene(5, 4, height=0.06)
EMBEDDING = Embedding(9, 11)
SOME = Conditions(
    bandwidth=(40e-9,) * 3,
    depth_range=0.1,
    imperfections=Imperfections(gamma=1.1, rotation=2e-3),
    bayer=True,
)


@pytest.fixture(scope="module")
def of_some() -> Plan:
    return plan(CAMERA, SCENE, EMBEDDING, 1e-3, SOME)


@pytest.mark.thorough
@pytest.mark.parametrize("tolerance", [5e-2, 3e-3, 3e-4])
@pytest.mark.parametrize("panel", [BARE, Panel(filter_leakage=0.1)], ids=["bare", "leaky"])
def test_measured_error_is_about_the_predicted(panel: Panel, tolerance: float) -> None:
    camera = replace(CAMERA, panel=panel)
    chosen = plan(camera, SCENE, EMBEDDING, tolerance)
    masks = [mask(camera, seed) for seed in (11, 12)]
    measured = torch.stack([axial(chosen)(weights) for weights in masks]).double()
    exact = (reference_transfer(camera, SCENE, EMBEDDING, w, oversampling=16) for w in masks)
    truth = torch.stack(list(exact))
    assert chosen.reached
    assert chosen.error <= tolerance
    # The reference has no field angle, and is Fresnel's, as the plan is.
    assert relative(measured, truth) < 2 * chosen.error + 3e-5


@pytest.mark.thorough
def test_finer_tolerances_cost_more_and_err_less(of_some: Plan) -> None:
    coarser = [plan(CAMERA, SCENE, EMBEDDING, tolerance, SOME) for tolerance in (1e-1, 1e-2)]
    plans = [*coarser, of_some]
    times = [chosen.cost.step_ms for chosen in plans]
    assert times == sorted(times)
    assert times[0] < times[-1]
    assert plans[0].error > plans[-1].error
    on = [sum(found.matters for found in chosen.assessments) for chosen in plans]
    assert on == sorted(on)
    assert on[0] < on[-1]


def test_dials_that_are_cheaper_would_not_have_done() -> None:
    chosen = plan(CAMERA, SCENE, EMBEDDING, 1e-3)
    fine = chosen.model.with_sampling(reach=Reach(11, 5), step=1e-6, dtype=torch.float64)
    finest = LightOperator(fine)(mask(CAMERA))
    reach = chosen.model.sampling.reach
    assert reach != Reach(0, 0)
    for rows in range(reach.rows + 1):
        for columns in range(reach.columns + 1):
            model = chosen.model.with_sampling(reach=Reach(rows, columns))
            if cost(model, 64).step_ms < chosen.cost.step_ms:
                assert relative(LightOperator(model)(mask(CAMERA)).double(), finest) > 0.8e-3


@pytest.mark.slow
def test_operator_learns_through_a_plan() -> None:
    chosen = plan(
        CAMERA,
        SCENE,
        EMBEDDING,
        1e-2,
        Conditions(imperfections=Imperfections(gamma=1.2), levels=64),
    )
    wanted = chosen.operator(mask(CAMERA, 5).float())
    weights = torch.full(CAMERA.mask_shape, 0.5, requires_grad=True)
    optimiser = torch.optim.Adam([weights], lr=0.05)
    losses = []
    for _ in range(60):
        optimiser.zero_grad()
        loss = (chosen.operator(weights) - wanted).square().sum() / wanted.square().sum()
        torch.autograd.backward(loss)
        optimiser.step()
        weights.data.clamp_(0, 1)
        losses.append(float(loss.detach()))
    assert losses[-1] < losses[0] / 20


NEAR_AND_FINE = replace(CAMERA, sensor=Sensor(rows=200, columns=240), distance=1e-5)
DARK = replace(CAMERA, panel=Panel(filter_cycle=(0,)), window=Window(3, 3))
GREEN = replace(CAMERA, sensor=Sensor(500, 600, channel_weights=(0.0, 1.0, 0.0)))
EXTREMES = [
    ("near", replace(CAMERA, distance=1e-6), SCENE, EMBEDDING, 1e-3),
    ("near and fine", NEAR_AND_FINE, SCENE, Embedding(50, 60), 1e-4),
    ("far", replace(CAMERA, distance=1.0), SCENE, EMBEDDING, 1e-2),
    ("very far", replace(CAMERA, distance=1e3), SCENE, EMBEDDING, 1e-2),
    ("ultraviolet", replace(CAMERA, wavelengths=(2e-7,) * 3), SCENE, EMBEDDING, 1e-3),
    ("infrared", replace(CAMERA, wavelengths=(1e-5,) * 3), SCENE, EMBEDDING, 1e-3),
    ("one sub-pixel", replace(CAMERA, window=Window(1, 1)), SCENE, EMBEDDING, 1e-3),
    ("one row", replace(CAMERA, window=Window(1, 9)), SCENE, EMBEDDING, 1e-3),
    ("whole panel", Camera(window=Window(384, 160, 0, 0)), SCENE, Embedding(1, 1), 1e-1),
    ("one pixel", CAMERA, Scene(1, 1), Embedding(1, 1), 1e-3),
    ("every sensor pixel", CAMERA, SCENE, Embedding(500, 600), 1e-2),
    ("more than every pixel", CAMERA, SCENE, Embedding(3000, 4000), 1e-2),
    ("huge scene", CAMERA, Scene(1000, 1000, height=2.0), EMBEDDING, 1e-2),
    ("touching scene", CAMERA, Scene(5, 4, height=0.01, distance=1e-4), EMBEDDING, 1e-2),
    ("stars", CAMERA, Scene(5, 4, height=1e9, distance=1e12), EMBEDDING, 1e-2),
    ("no tolerance to speak of", CAMERA, SCENE, EMBEDDING, 0.99),
    ("impossible tolerance", replace(CAMERA, window=Window(6, 3)), SCENE, EMBEDDING, 1e-300),
    ("dark channels", DARK, SCENE, EMBEDDING, 1e-3),
    ("green alone", GREEN, SCENE, EMBEDDING, 1e-3),
]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("camera", "scene", "embedding", "tolerance"),
    [job[1:] for job in EXTREMES],
    ids=[job[0] for job in EXTREMES],
)
def test_total(camera: Camera, scene: Scene, embedding: Embedding, tolerance: float) -> None:
    """No gap between methods: a plan for whatever can exist, and it explains itself."""
    chosen = plan(camera, scene, embedding, tolerance)
    assert 0 <= chosen.error < math.inf
    assert chosen.reached == (chosen.error <= tolerance and chosen.cost.numbers <= MAX_NUMBERS)
    assert math.isfinite(chosen.cost.step_ms)
    text = chosen.explain()
    assert all(effect.name in " ".join(text.split()) for effect in EFFECTS)
    assert "predicted error" in text
    if chosen.cost.step_ms < 300:
        values = chosen.embed(torch.ones(1, *scene.shape), mask(camera))
        assert tuple(values.shape) == (1, *embedding.shape)
        assert bool(torch.isfinite(values).all())


@pytest.mark.thorough
@pytest.mark.long
@settings(
    deadline=None,
    derandomize=True,
    # Whether the form is long is the same for every example.
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
@given(
    rows=st.integers(1, 9),
    columns=st.integers(1, 5),
    distance=st.floats(-4, -1),
    tolerance=st.floats(-4, -0.01),
    shape=st.tuples(st.integers(1, 20), st.integers(1, 20)),
    conditions=st.builds(
        Conditions,
        bandwidth=st.sampled_from([(0.0, 0.0, 0.0), (1e-8, 0.0, 2e-7)]),
        depth_range=st.sampled_from([0.0, 1e-3, 0.4]),
        imperfections=st.builds(
            Imperfections,
            gamma=st.floats(0.2, 5),
            rotation=st.sampled_from([0.0, 0.0, 1e-4, 0.5]),
            shift_y=st.floats(-1e-3, 1e-3),
            stray_light=st.floats(0, 1),
        ),
        bayer=st.booleans(),
        black_level=st.floats(0, 1),
        adc_bits=st.integers(1, 16),
    ),
)
def test_total_over_conditions(
    *,
    rows: int,
    columns: int,
    distance: float,
    tolerance: float,
    shape: tuple[int, int],
    conditions: Conditions,
    long_form: bool,
) -> None:
    """The short form embeds what a plan says takes less than 0.3 s; the long one all."""
    camera = Camera(
        window=Window(rows, columns), sensor=Sensor(rows=80, columns=100), distance=10**distance
    )
    chosen = plan(camera, Scene(2, 3, height=0.05), Embedding(*shape), 10**tolerance, conditions)
    assert 0 <= chosen.error < math.inf
    assert len(chosen.assessments) == len(EFFECTS)
    if long_form or chosen.cost.step_ms < 300:
        values = chosen.embed(torch.rand(2, 2, 3), mask(camera))
        assert bool(torch.isfinite(values).all())


def test_tolerance_that_cannot_be_reached_is_said() -> None:
    """A mask turned by 3 degrees needs the grid, and that is no better than a few per cent."""
    chosen = plan(
        CAMERA, SCENE, EMBEDDING, 1e-4, Conditions(imperfections=Imperfections(rotation=0.05))
    )
    assert not chosen.reached
    assert chosen.error > 1e-4
    assert "NOT reached" in chosen.explain()
    turned = plan(
        CAMERA, SCENE, EMBEDDING, 3e-2, Conditions(imperfections=Imperfections(rotation=0.4))
    )
    assert turned.model.sampling.method == "grid"
    assert turned.reached
    with pytest.raises(OpticsError, match="forms no transfer matrix: use embed"):
        turned.transfer(mask(CAMERA))


def test_matrices_that_do_not_fit_are_not_formed() -> None:
    scene = Scene(300, 300, height=0.06)
    chosen = plan(replace(CAMERA, window=Window(3, 2)), scene, Embedding(100, 120), 5e-2)
    assert chosen.model.sampling.method != "transfer"
    assert chosen.cost.numbers <= MAX_NUMBERS


def test_batch_moves_work_to_where_it_is_cheaper() -> None:
    scene = Scene(60, 60, height=0.06)
    few, many = (plan(CAMERA, scene, Embedding(24, 32), 1e-2, batch=n) for n in (1, 5000))
    assert many.model.sampling.method == "transfer"
    assert few.cost.step_ms < many.cost.step_ms
    assert few.model.sampling.method == "factors"
    with pytest.raises(OpticsError, match="batch = 0"):
        plan(CAMERA, SCENE, EMBEDDING, 1e-2, batch=0)


@pytest.mark.slow
def test_explanation_says_what_was_chosen(of_some: Plan) -> None:
    text = of_some.explain()
    sampling = of_some.model.sampling
    told = " ".join(text.split())
    for value in (
        f"reach of interference {sampling.reach.rows} rows, {sampling.reach.columns} columns",
        f"wavelengths per channel {sampling.wavelengths}",
        "number format float32",
        "tolerance 1.0e-03",
        "one step coarser",
        "one step finer",
    ):
        assert value in told
    for found in (found for found in of_some.assessments if found.present):
        line = next(line for line in text.splitlines() if line.startswith(f" {found.name} "))
        assert f" {'on' if found.matters else 'off'} " in line


def test_costs_count_what_is_computed() -> None:
    plain = Model(CAMERA, SCENE, EMBEDDING, IDEAL, Sampling(reach=Reach(0, 0)))
    least = cost(plain, 64).step_ms
    for dearer in (
        plain.with_sampling(reach=Reach(2, 0)),
        plain.with_sampling(reach=Reach(0, 1)),
        replace(plain, conditions=SOME).with_sampling(wavelengths=2),
        replace(plain, conditions=Conditions(imperfections=Imperfections(rotation=1e-3))),
        replace(plain, conditions=Conditions(bayer=True)),
        replace(plain, sampling=replace(plain.sampling, dtype=torch.float64)),
        replace(plain, sampling=replace(plain.sampling, method="grid")),
    ):
        assert cost(dearer, 64).step_ms > least
    assert cost(plain, 65).step_ms > least


def test_command_prints_a_plan() -> None:
    runner = CliRunner()
    arguments = ["plan", "--embedding", "3x4", "--tolerance", "1e-1", "--gamma", "1.2"]
    result = runner.invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert re.search(r"mask gamma +on", result.output)
    assert "predicted time" in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--tolerance", "2"], "tolerance = 2.0"),
        (["--embedding", "3by4"], "--embedding = 3by4 is not valid: use ROWSxCOLUMNS"),
        (["--distance", "-1"], "camera.distance = -1.0 m"),
        (["--gamma", "0"], "imperfections.gamma = 0.0"),
    ],
)
def test_command_refuses_bad_input(arguments: list[str], message: str) -> None:
    result = CliRunner().invoke(app, ["plan", *arguments])
    assert result.exit_code == 2
    assert message in " ".join(result.output.split())


def test_plan_holds_no_mask() -> None:
    chosen: Plan = plan(CAMERA, SCENE, EMBEDDING, 1e-1)
    chosen.embed(torch.ones(1, 5, 4), mask(CAMERA))
    assert "tensor(" not in repr(chosen)


@pytest.mark.parametrize("method", ["transfer", "factors", "grid"])
def test_method_that_is_asked_for_is_the_one_that_is_chosen(method: Method) -> None:
    chosen = plan(CAMERA, SCENE, EMBEDDING, 0.05, method=method)
    assert chosen.model.sampling.method == method
    assert chosen.reached


def test_where_shadows_do_every_other_effect_is_still_judged() -> None:
    """One pixel as large as the sensor needs no diffraction; its filters take two thirds."""
    chosen = plan(Camera(), Scene(), Embedding(1, 1), 0.1)
    on = {found.name: found.error for found in chosen.assessments if found.matters}
    assert not chosen.model.sampling.diffraction
    assert on["colour filters"] > 1
    assert on["dead space"] > 0.1
    weights = mask(Camera())
    exact = TransferOperator(Camera(), Scene(), Embedding(1, 1), dtype=torch.float64)(weights)
    assert relative(chosen.transfer(weights).double(), exact) < 0.1


def test_sensor_a_micrometre_behind_the_mask_sees_shadows() -> None:
    """Each pixel's light is that of the part of the mask in front of it, in closed form."""
    near = replace(CAMERA, distance=1e-6, sensor=Sensor(24, 24, pixel=73e-6 / 8))
    chosen = plan(near, Scene(1, 1, height=1e-3), Embedding(1, 1), 1e-2)
    weights = torch.ones(near.mask_shape, dtype=torch.float64)
    side = 24 * 73e-6 / 8
    open_y = _open(near.row_centres, near.panel.aperture_y, side)
    open_x = _open(near.column_centres, near.panel.aperture_x, side)
    assert float(chosen.transfer(weights)) == pytest.approx(open_y * open_x, rel=2e-2)


def _open(centres: tuple[float, ...], width: float, side: float) -> float:
    ends = [
        (max(-side / 2, centre - width / 2), min(side / 2, centre + width / 2))
        for centre in centres
    ]
    return sum(max(0.0, high - low) for low, high in ends) / side


def test_field_angle_of_the_scene_is_in_the_plan() -> None:
    """At the upper edge of the default scene light is 4 % fainter than on the axis."""
    chosen = plan(Camera(), Scene(), Embedding(3, 4), 1e-2)
    found = {each.name: each for each in chosen.assessments}
    assert found["field angle"].matters
    assert 1e-2 < found["field angle"].error < 5e-2
    transfer = chosen.transfer(mask(Camera()).float()).reshape(28, 28, -1)
    flat = axial(chosen)(mask(Camera()).float()).reshape(28, 28, -1)
    ratio = float(transfer[0, 14].sum() / flat[0, 14].sum())
    assert ratio == pytest.approx((1 + (0.06 * 27 / 28 / 0.4) ** 2) ** -2, rel=5e-3)


def test_light_at_large_angles_is_in_the_budget() -> None:
    """Sub-pixels of two wavelengths spread it so far that no factored field is right."""
    fine = bare(1.2e-6, 1.2e-6)
    camera = Camera(panel=fine, window=Window(4, 4), sensor=Sensor(8, 8, 1e-6), distance=2e-5)
    chosen = plan(camera, Scene(2, 2, height=0.02), Embedding(2, 2), 1e-3, method="transfer")
    found = {each.name: each for each in chosen.assessments}
    assert found["non-paraxial diffraction"].error > 1e-2
    assert not found["non-paraxial diffraction"].matters
    assert not chosen.reached
    assert "non-paraxial diffraction" in chosen.explain()
