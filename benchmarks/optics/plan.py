"""Whether plans keep what they promise, and whether they are the fastest that do.

Over many random cameras, scenes, embeddings, conditions and tolerances, all from one seed:

- ``plan_honest_fraction``: how often the measured error of a plan is at most twice the predicted.
  The truth is a far finer setting of the same physics; on some cases that is compared with direct
  integration of the whole field, which shares nothing with it but the field of one aperture.
- ``plan_worst_time_over_best``: the longest time of a plan over that of the fastest sampling
  that reaches the tolerance, as measured: by two standard errors, so not by the luck of the masks
  that were drawn. Plan and rivals take turns, and the ratio is the median over the rounds.

At the end the step of the leanest plan and of one with every effect on are timed side by side.

    python -m benchmarks.optics.plan --figures benchmarks/results/optics.json
"""

from __future__ import annotations

import math
import random
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import record
from rich.console import Console
from rich.progress import track
from rich.table import Table
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import (
    IDEAL,
    NOMINAL,
    Conditions,
    Imperfections,
    half_field,
)
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.plan import Plan, plan
from veilcam_optics.plan.cost import cost
from veilcam_optics.plan.search import MAX_NUMBERS
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.operator import Reach
from veilcam_optics.transfer.reference import reference_transfer

BATCH = 64
EMBEDDINGS = ((1, 1), (3, 4), (6, 8), (12, 16), (13, 17), (24, 32), (27, 36), (48, 64))


@dataclass(frozen=True)
class Case:
    """One random job."""

    camera: Camera
    scene: Scene
    embedding: Embedding
    conditions: Conditions
    tolerance: float

    @property
    def unit(self) -> int:
        """Rows between the nearest two that pass the same light."""
        panel = self.camera.panel
        if not panel.filter_cycle or panel.filter_leakage:
            return 1
        return len(panel.filter_cycle)


def draw(generator: random.Random) -> Case:
    """A case of everyday to rather odd geometry."""
    pitch_y = generator.uniform(40e-6, 110e-6)
    pitch_x = pitch_y * generator.choice([1, 2, 3])
    fill = generator.uniform(0.6, 1)
    panel = Panel(
        pitch_y=pitch_y,
        pitch_x=pitch_x,
        aperture_y=fill * pitch_y,
        aperture_x=fill * pitch_x,
        filter_cycle=generator.choice([(), (0, 1, 2)]),
        filter_leakage=generator.choice([0.0, 0.0, generator.uniform(0.01, 0.2)]),
    )
    camera = Camera(
        panel=panel,
        window=Window(generator.randint(4, 60), generator.randint(2, 30)),
        sensor=Sensor(generator.randint(400, 1600), generator.randint(400, 1600)),
        distance=_log_uniform(generator, 1e-3, 20e-3),
        wavelengths=(
            generator.uniform(600e-9, 700e-9),
            generator.uniform(520e-9, 580e-9),
            generator.uniform(430e-9, 490e-9),
        ),
    )
    scene_distance = generator.uniform(0.2, 2.0)
    side = generator.uniform(0.1, 1.0) * camera.sensor.height
    scene = Scene(
        rows=generator.randint(4, 6),
        columns=generator.randint(4, 6),
        height=side * scene_distance / camera.distance,
        distance=scene_distance,
    )
    # A scene wider than it is far away is no scene for a paraxial camera.
    scene = replace(scene, height=min(scene.height, 0.8 * scene_distance))
    return Case(
        camera,
        scene,
        Embedding(*generator.choice(EMBEDDINGS)),
        _some_conditions(generator, camera, scene),
        _log_uniform(generator, 1e-4, 1e-1),
    )


def _some_conditions(generator: random.Random, camera: Camera, scene: Scene) -> Conditions:
    """None in every other case, else one to three of them."""
    if generator.random() < 0.5:
        return IDEAL
    conditions = IDEAL
    changes: list[Callable[[Conditions], Conditions]] = [
        lambda c: replace(c, bandwidth=(generator.uniform(5e-9, 60e-9),) * 3),
        lambda c: replace(c, depth_range=generator.uniform(0.01, 0.4) * scene.distance),
        lambda c: replace(c, off_axis=half_field(scene)),
        lambda c: _with(c, gamma=generator.uniform(0.8, 1.3)),
        lambda c: _with(c, contrast_floor=_log_uniform(generator, 1e-3, 1e-1)),
        lambda c: replace(c, levels=generator.choice([8, 16, 64, 256])),
        lambda c: _with(c, shift_y=_log_uniform(generator, 1e-8, 5e-5), shift_x=1e-6),
        lambda c: _with(c, distance_error=camera.distance * _log_uniform(generator, 1e-5, 2e-2)),
        lambda c: _with(c, stray_light=_log_uniform(generator, 1e-4, 1e-1)),
        lambda c: replace(c, bayer=True),
    ]
    for change in generator.sample(changes, generator.randint(1, 3)):
        conditions = change(conditions)
    return conditions


def _with(conditions: Conditions, **changes: float) -> Conditions:
    imperfections = replace(conditions.imperfections, **changes)  # type: ignore[arg-type]
    return replace(conditions, imperfections=imperfections)


def _log_uniform(generator: random.Random, low: float, high: float) -> float:
    return math.exp(generator.uniform(math.log(low), math.log(high)))


def some_masks(case: Case, count: int) -> list[Tensor]:
    """Masks that no plan has seen."""
    generator = torch.Generator().manual_seed(987654321)
    return [
        torch.rand(case.camera.mask_shape, generator=generator, dtype=torch.float64)
        for _ in range(count)
    ]


def true_model(case: Case, chosen: Reach) -> Model:
    """A setting far finer than any that a plan would choose.

    Over a wide field every zone has kernels of its own, and pairs as far apart as elsewhere would
    take minutes each: there, the pairs are those within ``chosen``, the plan's reach, and the
    nearest two shells beyond it, which hold nearly all that it leaves out.
    """
    camera = case.camera
    reach = Reach(8 * case.unit + 4, 6)
    if case.conditions.off_axis:
        reach = Reach(chosen.rows + 2 * case.unit, chosen.columns + 2)
    rows, columns = camera.window.rows - 1, camera.window.columns - 1
    reach = Reach(min(rows, reach.rows), min(columns, reach.columns))
    apart = max(camera.panel.pitch_y * (1 + reach.rows), camera.panel.pitch_x * (1 + reach.columns))
    sensor, embedding = camera.sensor, case.embedding
    pixel = min(sensor.height / embedding.rows, sensor.width / embedding.columns)
    fringe = 0.9 * min(camera.wavelengths) * camera.distance / apart
    sampling = Sampling(
        reach=reach,
        wavelengths=7,
        layers=7,
        zones=6,  # each pixel of the scene has its own
        step=min(fringe / 3, pixel / 20),
        dtype=torch.float64,
    )
    return Model(camera, case.scene, embedding, case.conditions, sampling)


def relative(values: list[Tensor], truths: list[Tensor]) -> float:
    """Root mean square over the masks, relative to that of the truths."""
    differences = sum(
        float((v.double() - t).square().sum()) for v, t in zip(values, truths, strict=True)
    )
    return math.sqrt(differences / sum(float(t.square().sum()) for t in truths))


def spread(values: list[Tensor], truths: list[Tensor]) -> float:
    """Standard error of :func:`relative`, from how much the masks differ."""
    size = math.sqrt(statistics.mean(float(t.square().sum()) for t in truths))
    squares = [
        float((v.double() - t).square().sum()) / size**2
        for v, t in zip(values, truths, strict=True)
    ]
    mean = statistics.mean(squares)
    if len(squares) < 2 or not mean:
        return 0.0
    return statistics.stdev(squares) / math.sqrt(len(squares)) / (2 * math.sqrt(mean))


def matrices(operator: LightOperator, masks: list[Tensor]) -> list[Tensor]:
    """The transfer matrix of every mask, by whatever method."""
    with torch.no_grad():
        if operator.has_transfer:
            return [operator(mask) for mask in masks]
        rows, columns = operator.model.scene.shape
        points = torch.eye(rows * columns, dtype=operator.dtype).reshape(-1, rows, columns)
        return [operator.embed(points, mask).flatten(1) for mask in masks]


def rivals(case: Case, chosen: Plan) -> Iterator[Model]:
    """Dial settings that may be faster than the plan: all not twice as costly by estimate."""
    unit, window = case.unit, case.camera.window
    rows = sorted({min(k * unit, window.rows - 1) for k in (0, 1, 2, 3)})
    columns = sorted({min(k, window.columns - 1) for k in (0, 1, 2)})
    conditions = case.conditions
    leaks = [case.camera]
    if case.camera.panel.filter_cycle and case.camera.panel.filter_leakage:
        leaks.append(replace(case.camera, panel=replace(case.camera.panel, filter_leakage=0.0)))
    there = (any(conditions.bandwidth), conditions.depth_range > 0, conditions.off_axis > 0)
    # Where several are there, a setting takes up to a minute to make.
    samples = (1, 2, 3, 5) if sum(there) < 2 else (1, 3)
    spectra, layers, zones = (samples if each else (1,) for each in there)
    patterns = (False, True) if conditions.bayer else (False,)
    limit = 2 * cost(chosen.model, BATCH).step_ms
    step = chosen.model.sampling.step
    for near, camera, spectrum, layer, zone, bayer in product(
        product(rows, columns), leaks, spectra, layers, zones, patterns
    ):
        for diffraction in (True, False) if near == (0, 0) else (True,):
            sampling = Sampling(
                diffraction=diffraction,
                reach=Reach(*near),
                wavelengths=spectrum,
                layers=layer,
                zones=zone,
                step=step,
            )
            model = Model(
                camera, case.scene, case.embedding, replace(conditions, bayer=bayer), sampling
            )
            estimate = cost(model, BATCH)
            if estimate.step_ms <= limit and estimate.numbers <= MAX_NUMBERS:
                yield model


def fineness(model: Model) -> tuple[int, ...]:
    """Of everything that rivals differ in; what is larger is finer, and takes longer."""
    sampling = model.sampling
    return (
        int(sampling.diffraction),
        sampling.reach.rows,
        sampling.reach.columns,
        sampling.wavelengths,
        sampling.layers,
        sampling.zones,
        int(model.conditions.bayer),
        int(model.camera.panel.filter_leakage > 0),
    )


def measured_rivals(
    models: list[Model], weights: list[Tensor], truths: list[Tensor], case: Case
) -> Iterator[tuple[Model, LightOperator, bool]]:
    """Rivals, and whether they reach the tolerance, as measured.

    What is coarser in everything than a rival that misses it will miss it, too; what is finer in
    everything than one that reaches it takes longer. Neither is looked at: it would take hours.
    """
    left = {model: fineness(model) for model in models}

    def beside(model: Model, *, finer: bool) -> list[Model]:
        mine = left[model]
        return [
            other
            for other, sampling in left.items()
            if all((d >= m) if finer else (d <= m) for d, m in zip(sampling, mine, strict=True))
        ]

    while left:
        model = max(
            left, key=lambda m: min(len(beside(m, finer=True)), len(beside(m, finer=False)))
        )
        operator = LightOperator(model)
        values = matrices(operator, weights)
        # By two standard errors, so not by the luck of these masks.
        reaches = relative(values, truths) + 2 * spread(values, truths) <= case.tolerance
        yield model, operator, reaches
        for other in beside(model, finer=reaches):
            del left[other]


def step_of(operator: LightOperator, mask: Tensor) -> Callable[[], object]:
    """A step: a mask, and a batch of scenes behind it."""
    scenes = torch.rand(
        BATCH, *operator.model.scene.shape, generator=torch.Generator().manual_seed(3)
    ).to(operator.dtype)
    weights = mask.to(operator.dtype)
    generator = torch.Generator().manual_seed(4)

    def step() -> object:
        with torch.no_grad():
            return operator.embed(scenes, weights, generator)

    return step


def ratio(first: Callable[[], object], second: Callable[[], object], rounds: int) -> float:
    """Median over the rounds of the time of ``first`` over that of ``second``."""
    for run in (first, second) * 2:
        run()
    ratios = []
    for turn in range(rounds):
        # Whoever goes second may find a warmer cache: they change places.
        order = (first, second) if turn % 2 else (second, first)
        taken = {}
        for run in order:
            start = time.perf_counter()
            run()
            taken[run] = time.perf_counter() - start
        ratios.append(taken[first] / taken[second])
    return statistics.median(ratios)


@dataclass(frozen=True)
class Result:
    """What came out of one case."""

    case: Case
    chosen: Plan
    seconds: float
    measured: float
    ratio: float
    """Time of the plan over that of the fastest rival that reaches the tolerance; at least 1."""
    rival: Model | None

    @property
    def honest(self) -> bool:
        """Measured at most twice predicted."""
        return self.measured <= 2 * self.chosen.error


def judge(case: Case, *, masks: int, rounds: int) -> Result:
    """Plan one case, and compare the plan with the truth and with its rivals."""
    start = time.perf_counter()
    chosen = plan(
        case.camera, case.scene, case.embedding, case.tolerance, case.conditions, batch=BATCH
    )
    seconds = time.perf_counter() - start
    # Small masks differ more.
    size = case.camera.window.rows * case.camera.window.columns
    weights = some_masks(case, masks * max(1, min(4, 800 // size)))
    truths = matrices(LightOperator(true_model(case, chosen.model.sampling.reach)), weights)
    measured = relative(matrices(chosen.operator, weights), truths)
    worst, rival = 1.0, None
    mine = step_of(chosen.operator, weights[0])
    for model, operator, reaches in measured_rivals(
        [model for model in rivals(case, chosen) if model != chosen.model], weights, truths, case
    ):
        if not reaches:
            continue
        other = step_of(operator, weights[0])
        slower = ratio(mine, other, 9)
        if slower > max(1.1, worst):
            # Worth a careful look.
            slower = ratio(mine, other, rounds)
            if slower > worst:
                worst, rival = slower, model
    return Result(case, chosen, seconds, measured, worst, rival)


def against_integration(case: Case) -> float:
    """Relative L2 between the truth and direct integration of the whole field."""
    ideal = replace(case, conditions=IDEAL)
    weights = some_masks(ideal, 1)
    truth = matrices(LightOperator(true_model(ideal, Reach())), weights)
    whole = max(
        case.camera.window.rows * case.camera.panel.pitch_y,
        case.camera.window.columns * case.camera.panel.pitch_x,
    )
    fringe = min(case.camera.wavelengths) * case.camera.distance / whole
    oversampling = min(64, max(16, math.ceil(1.2 * 8 * case.camera.sensor.pixel / fringe)))
    reference = reference_transfer(
        case.camera, case.scene, case.embedding, weights[0], oversampling=oversampling
    )
    return relative(truth, [reference])


def everything() -> Conditions:
    """Conditions under which a plan at 1e-4 needs every effect there is."""
    return Conditions(
        bandwidth=(40e-9,) * 3,
        depth_range=0.1,
        off_axis=half_field(Scene()),
        imperfections=Imperfections(
            gamma=1.1,
            contrast_floor=0.03,
            shift_y=2e-5,
            shift_x=1e-5,
            rotation=2e-3,
            distance_error=5e-5,
            stray_light=0.02,
        ),
        levels=64,
        bayer=True,
        electrons=1e5,
        read_noise=20.0,
        full_well=1e4,
        adc_bits=8,
        black_level=0.01,
    )


def side_by_side(console: Console, rounds: int) -> dict[str, float]:
    """Print the step of the leanest plan and of one with every effect, for the default camera.

    Returns:
        Median milliseconds by the figure's name.
    """
    leaky = Camera(panel=Panel(filter_leakage=0.1))
    plans = {
        "ordinary scene, 1e-2": plan(Camera(), Scene(), Embedding(), 1e-2),
        "ordinary scene, 1e-3": plan(Camera(), Scene(), Embedding(), 1e-3),
        "every effect, 1e-2": plan(leaky, Scene(), Embedding(), 1e-2, everything()),
        "every effect, 1e-3": plan(leaky, Scene(), Embedding(), 1e-3, everything()),
    }
    mask = torch.rand(Camera().mask_shape, generator=torch.Generator().manual_seed(0))
    steps = {name: step_of(chosen.operator, mask) for name, chosen in plans.items()}
    for step in steps.values():
        step()
    times: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(rounds):
        for name, step in steps.items():
            start = time.perf_counter()
            step()
            times[name].append(1e3 * (time.perf_counter() - start))
    table = Table(title=f"One step: a new mask, {BATCH} scenes, 24 x 32")
    for heading in ("plan", "effects on", "predicted error", "predicted [ms]", "measured [ms]"):
        table.add_column(heading, justify="left" if heading == "plan" else "right")
    for name, chosen in plans.items():
        table.add_row(
            name,
            str(sum(found.matters for found in chosen.assessments)),
            f"{chosen.error:.1e}",
            f"{chosen.cost.step_ms:.1f}",
            f"{statistics.median(times[name]):.1f}",
        )
    console.print(table)
    return {
        f"plan_step_ms_{name.replace(',', '').replace(' ', '_')}": round(statistics.median(each), 2)
        for name, each in times.items()
    }


def main(
    *,
    cases: Annotated[int, typer.Option(help="Random cases.")] = 200,
    masks: Annotated[int, typer.Option(help="Masks behind each measured error.")] = 4,
    rounds: Annotated[int, typer.Option(help="Turns of plan and rival.")] = 31,
    seed: int = 2022,
    quick: Annotated[bool, typer.Option(help="A few cases; writes no figures.")] = False,
    verbose: Annotated[bool, typer.Option(help="One line for each case.")] = False,
    figures: Annotated[Path | None, typer.Option(help="Record to merge the figures into.")] = None,
) -> None:
    """Measure how honest and how fast plans are."""
    torch.set_num_threads(1)
    console = Console()
    if quick:
        cases, masks, rounds = 8, 2, 9
    generator = random.Random(seed)
    drawn = [draw(generator) for _ in range(cases)]
    checked = drawn[:: max(1, cases // (3 if quick else 12))]
    agreement = [
        against_integration(case)
        for case in track(checked, "truth against integration", console=console)
    ]
    console.print(
        f"truth against direct integration, {len(agreement)} cases: median "
        f"{statistics.median(agreement):.1e}, worst {max(agreement):.1e}"
    )
    results = []
    for case in track(drawn, "cases", console=console):
        results.append(judge(case, masks=masks, rounds=rounds))
        if verbose:
            console.print(describe(results[-1]), highlight=False, markup=False)
    report(console, results)
    steps = side_by_side(console, rounds)
    if not quick:
        reaching = [result.ratio for result in results if result.chosen.reached]
        record(
            figures,
            {
                "plan_honest_fraction": sum(r.honest for r in results) / len(results),
                "plan_worst_time_over_best": round(max(reaching), 3),
                **steps,
            },
        )


def describe(result: Result) -> str:
    """One line."""
    case, chosen = result.case, result.chosen
    sampling = chosen.model.sampling
    conditions = [
        name
        for given, usual in ((case.conditions, IDEAL), (case.conditions.imperfections, NOMINAL))
        for name in given.__dataclass_fields__
        if getattr(given, name) != getattr(usual, name)
    ]
    rival = result.rival.sampling if result.rival else None
    return (
        f"{'    ' if result.honest else 'FAR '}{'' if chosen.reached else 'OUT '}"
        f"tol {case.tolerance:.1e} predicted {chosen.error:.1e} measured {result.measured:.1e} "
        f"ratio {result.ratio:.2f} plan {result.seconds:.1f} s | {case.camera.mask_shape} "
        f"{1e3 * case.camera.distance:.1f} mm {case.embedding.shape} "
        f"{'filters' if case.camera.panel.filter_cycle else 'bare'} {conditions} | "
        f"{'shadow' if not sampling.diffraction else sampling.reach} "
        f"{sampling.wavelengths} {sampling.layers} "
        f"{sampling.zones} {1e6 * sampling.step:.2f} um"
        + (
            f" | rival {rival.reach if rival.diffraction else 'shadow'} {rival.wavelengths} "
            f"{rival.layers} {rival.zones}"
            if rival
            else ""
        )
    )


def report(console: Console, results: list[Result]) -> None:
    """Print what came out."""
    reached = [result for result in results if result.chosen.reached]
    honest = sum(result.honest for result in results)
    within = sum(result.measured <= result.case.tolerance for result in reached)
    ratios = sorted((result.ratio for result in reached), reverse=True)
    seconds = sorted(result.seconds for result in results)
    console.print(f"measured error at most twice the predicted: {honest} of {len(results)}")
    console.print(f"plans that reach their tolerance: {len(reached)}; measured to: {within}")
    console.print(
        f"time over the fastest that reaches: worst {ratios[0]:.2f}, then "
        + ", ".join(f"{value:.2f}" for value in ratios[1:6])
    )
    console.print(f"planning took {statistics.median(seconds):.2f} s, at most {seconds[-1]:.2f} s")


if __name__ == "__main__":
    typer.run(main)
