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
from benchmarks.optics.plan_cases import (
    Case,
    against_integration,
    draw,
    matrices,
    relative,
    some_masks,
    spread,
    true_model,
)
from rich.console import Console
from rich.progress import track
from rich.table import Table
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene
from veilcam_optics.camera.imperfections import (
    IDEAL,
    NOMINAL,
    Conditions,
    Imperfections,
)
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.plan import Plan, plan
from veilcam_optics.plan.cost import cost
from veilcam_optics.plan.search import MAX_NUMBERS
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.tables import Reach

BATCH = 64


def rivals(case: Case, chosen: Plan) -> Iterator[Model]:
    """Dial settings that may be faster than the plan: all not twice as costly by estimate."""
    unit, window = case.unit, case.camera.window
    rows = sorted({min(k * unit, window.rows - 1) for k in (0, 1, 2, 3)})
    columns = sorted({min(k, window.columns - 1) for k in (0, 1, 2)})
    conditions = case.conditions
    leaks = [case.camera]
    if case.camera.panel.filter_cycle and case.camera.panel.filter_leakage:
        leaks.append(replace(case.camera, panel=replace(case.camera.panel, filter_leakage=0.0)))
    there = (any(conditions.bandwidth), conditions.depth_range > 0, True)
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


def everything() -> Conditions:
    """Conditions under which a plan at 1e-4 needs every effect there is."""
    return Conditions(
        bandwidth=(40e-9,) * 3,
        depth_range=0.1,
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
