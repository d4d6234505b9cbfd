"""Planning: from a tolerance to the cheapest computation, with the reasons."""

import io
from dataclasses import dataclass
from functools import cached_property

import torch
from rich import box
from rich.console import Console
from rich.table import Column, Table
from torch import Tensor

from veilcam_optics import effects
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import (
    IDEAL,
    Conditions,
)
from veilcam_optics.effects import Assessment, Model
from veilcam_optics.effects.composition import present
from veilcam_optics.effects.model import Method
from veilcam_optics.errors import require, require_count
from veilcam_optics.plan.bounds import check_lit
from veilcam_optics.plan.cost import Cost, cost
from veilcam_optics.plan.errors import ErrorModel
from veilcam_optics.plan.probe import cropped
from veilcam_optics.plan.search import Candidate, search
from veilcam_optics.simulation.check import Check, check
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.simulation.psf import psf

_METHODS = {
    "transfer": "transfer operator (matrix from scene to embedding)",
    "factors": "factored field (its factors, no matrix formed)",
    "grid": "grid (angular spectrum, convolution)",
}


@dataclass(frozen=True)
class Plan:
    """A way to compute embeddings that was chosen for a tolerance; it explains itself, and runs.

    Attributes:
        model: model that is computed, with its sampling.
        asked: model with every effect, which the plan stands for.
        tolerance: relative L2 error asked for, at the embedding.
        error: relative L2 error predicted.
        reached: True where the prediction is within the tolerance; if not, this is the best.
        cost: predicted time and memory of a step.
        batch: scenes in a step.
        assessments: every effect, on or off, and why.
        coarser: next setting that is cheaper and less accurate, if there is one.
        finer: next setting that is dearer and more accurate, if there is one.
        bounds: bounds of planning that were met, in words.
    """

    model: Model
    asked: Model
    tolerance: float
    error: float
    reached: bool
    cost: Cost
    batch: int
    assessments: tuple[Assessment, ...]
    coarser: Candidate | None = None
    finer: Candidate | None = None
    bounds: tuple[str, ...] = ()

    @cached_property
    def operator(self) -> LightOperator:
        """The operator, made on first use. Call it for the transfer matrix, also in training."""
        return LightOperator(self.model)

    def transfer(self, weights: Tensor) -> Tensor:
        """Return the transfer matrix of a mask, (scene pixels, embedding pixels).

        Raises:
            OpticsError: the plan's method forms no matrix, or the mask has another shape or NaN.
        """
        transfer: Tensor = self.operator(weights)
        return transfer

    def embed(
        self, scenes: Tensor, weights: Tensor, generator: torch.Generator | None = None
    ) -> Tensor:
        """Return the camera's readings of scenes behind a mask, (batch, rows, columns).

        Args:
            scenes: (batch, rows, columns), in [0, 1].
            weights: amplitude transmittances asked of the panel, ``camera.mask_shape``.
            generator: source of the noise, if there is any.

        Raises:
            OpticsError: scenes or mask have another shape, or the mask holds NaN.
        """
        return self.operator.embed(scenes, weights, generator)

    def check(self, weights: Tensor, *, entries: int = 48, seed: int = 0) -> Check:
        """Estimate the relative L2 error of this mask's transfer, from entries drawn at random.

        Args:
            weights: amplitude transmittances asked of the panel, ``camera.mask_shape``.
            entries: number of entries to draw, each at the cost of milliseconds; 8 or more.
            seed: seed of the draw.

        Raises:
            OpticsError: as :func:`~veilcam_optics.simulation.check.check` says.
        """
        return check(self.operator, self.asked, weights, entries=entries, seed=seed)

    def psf(self, weights: Tensor, rows: int = 120) -> Tensor:
        """Return the point spread function of a mask, (3, rows, columns): see :mod:`.psf`.

        Args:
            weights: amplitude transmittances asked of the panel, ``camera.mask_shape``.
            rows: cells along the sensor's short side; cells are about square.

        Raises:
            OpticsError: the mask has another shape or holds NaN; no rows; a turned mask.
        """
        return psf(self.asked, weights, rows)

    def explain(self) -> str:
        """Return a table of every effect, and of the chosen setting."""
        return explanation(self)

    def _repr_html_(self) -> str:
        """Return the same for a notebook."""
        console = Console(file=io.StringIO(), width=118, record=True)
        print_explanation(self, console)
        return console.export_html(inline_styles=True, code_format="<pre>{code}</pre>")


def plan(
    camera: Camera,
    scene: Scene,
    embedding: Embedding,
    tolerance: float,
    conditions: Conditions = IDEAL,
    *,
    batch: int = 64,
    method: Method | None = None,
) -> Plan:
    """Choose the cheapest way to compute embeddings to within a tolerance.

    Total: for any camera, scene and conditions that can exist it returns a plan. If no setting
    reaches the tolerance the plan says so (``reached``) and holds the best.

    Args:
        camera: geometry, filters and wavelengths.
        scene: flat object, or its middle if ``conditions`` give it depth.
        embedding: shape of the embedding.
        tolerance: relative L2 error at the embedding, over random masks; between 0 and 1.
        conditions: departures of camera and scene from the ideal.
        batch: scenes embedded with one mask, what the time of a step is counted for.
        method: the only one to choose from; by default all. A camera that is simulated to test a
            transfer matrix, say, had better not be made of one.

    Raises:
        OpticsError: a tolerance outside (0, 1), no batch, or conditions that cannot be.
    """
    require(0 < tolerance < 1, "tolerance", tolerance, "(relative L2)", "a number between 0 and 1")
    require_count("batch", batch)
    asked = Model(camera, scene, embedding, conditions)
    check_lit(asked)
    error_model = ErrorModel(asked, tolerance)
    complete = error_model.model
    errors = {effect.name: effect.error(error_model) for effect in present(complete)}
    choice = search(error_model, errors, tolerance, batch=batch, method=method)
    chosen = choice.best.model
    return Plan(
        model=chosen,
        asked=asked,
        tolerance=tolerance,
        error=error_model.read(choice.best.error),
        reached=choice.reached,
        cost=cost(chosen, batch),
        batch=batch,
        assessments=_assess(complete, chosen, errors, batch),
        coarser=choice.coarser,
        finer=choice.finer,
        bounds=_bounds_met(error_model, asked),
    )


def _bounds_met(error_model: ErrorModel, asked: Model) -> tuple[str, ...]:
    """Say which bounds of planning were met."""
    met = ["time: no finer sampling was looked at"] if error_model.late else []
    rows, columns = asked.camera.mask_shape
    seen = cropped(asked).camera.mask_shape
    if seen != (rows, columns):
        met.append(f"window: errors are those of the middle {seen[0]} x {seen[1]} sub-pixels")
    return tuple(met)


def _assess(
    complete: Model, chosen: Model, errors: dict[str, float], batch: int
) -> tuple[Assessment, ...]:
    """Every effect: used or not in the chosen model, and what it costs there."""
    found = []
    for effect in effects.EFFECTS:
        if effect.name not in errors:
            found.append(Assessment(effect.name, False, 0.0, 0.0, effect.absent, present=False))
            continue
        used = effect.present(chosen) and effect.without(chosen) != chosen
        extra = cost(chosen, batch).step_ms - cost(effect.without(chosen), batch).step_ms
        found.append(
            Assessment(
                effect.name,
                used,
                errors[effect.name],
                max(0.0, extra) if used else 0.0,
                effect.reason(complete),
            )
        )
    return tuple(found)


def table(plan: Plan) -> Table:
    """Every effect that is there: on or off, error if ignored, cost, reason."""
    shown = Table(
        Column("effect", no_wrap=True),
        Column("", no_wrap=True),
        Column("error if ignored", justify="right", no_wrap=True),
        Column("cost [ms]", justify="right", no_wrap=True),
        "why",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    for found in plan.assessments:
        if found.present:
            shown.add_row(
                found.name,
                "on" if found.matters else "off",
                f"{found.error:.1e}",
                f"{found.cost_ms:.2f}",
                found.reason,
                style="" if found.matters else "dim",
            )
    return shown


def setting(plan: Plan) -> list[tuple[str, str]]:
    """List the chosen setting, as (name, value)."""
    model, sampling = plan.model, plan.model.sampling
    light = "geometric shadows"
    if sampling.diffraction:
        light = f"{sampling.reach.rows} rows, {sampling.reach.columns} columns"
    chosen = [("method", _METHODS[sampling.method])]
    if sampling.method == "grid":
        chosen.append(("oversampling", f"{sampling.oversampling:g} samples per 8 sensor pixels"))
    else:
        chosen.append(("reach of interference", light))
        chosen.append(("integration step", f"{sampling.step * 1e6:.3g} um"))
    samples = sampling.wavelengths if any(model.conditions.bandwidth) else 1
    chosen.append(("wavelengths per channel", str(samples)))
    if model.conditions.depth_range:
        chosen.append(("depth layers", str(sampling.layers)))
    if model.sampling.oblique:
        chosen.append(("zones of the field", f"{sampling.zones} x {sampling.zones}"))
    verdict = "reached" if plan.reached else "NOT reached: this is the most accurate setting"
    return [
        *chosen,
        ("number format", str(sampling.dtype).removeprefix("torch.")),
        ("tolerance", f"{plan.tolerance:.1e}, {verdict}"),
        ("predicted error", f"{plan.error:.1e} (relative L2 at the embedding)"),
        ("predicted time", f"{_time(plan.cost)} for a new mask and {plan.batch} scenes"),
        *(
            (name, "none" if other is None else f"error {other.error:.1e}, {_time(other.cost)}")
            for name, other in (("one step coarser", plan.coarser), ("one step finer", plan.finer))
        ),
        *(("bound met", bound) for bound in plan.bounds),
        ("not there", ", ".join(a.name for a in plan.assessments if not a.present) or "nothing"),
    ]


def _time(cost: Cost) -> str:
    return f"{cost.step_ms:.2f} ms ({cost.build_ms / 1e3:.1f} s to make)"


def explanation(plan: Plan, width: int = 118) -> str:
    """Return the table and the setting, as plain text."""
    text = io.StringIO()
    console = Console(file=text, width=width, force_terminal=False, color_system=None)
    print_explanation(plan, console)
    return text.getvalue()


def print_explanation(plan: Plan, console: Console) -> None:
    """Print the table and the setting."""
    console.print(table(plan))
    rows = Table.grid(Column(no_wrap=True), Column(), padding=(0, 2, 0, 0))
    for row in setting(plan):
        rows.add_row(*row)
    console.print(rows, highlight=False)
