"""A plan in words: a table of every effect, and the setting that was chosen."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from veilcam_optics.plan.planning import Plan

_METHODS = {
    "transfer": "transfer operator (matrix from scene to embedding)",
    "factors": "factored field (its factors, no matrix formed)",
    "grid": "grid (angular spectrum, convolution)",
}


def table(plan: Plan) -> Table:
    """Every effect: on or off, error if ignored, cost, reason."""
    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    shown.add_column("effect", no_wrap=True)
    shown.add_column("", no_wrap=True)
    shown.add_column("error if ignored", justify="right", no_wrap=True)
    shown.add_column("cost [ms]", justify="right", no_wrap=True)
    shown.add_column("why")
    for found in plan.assessments:
        shown.add_row(
            found.name,
            "on" if found.matters else "off",
            f"{found.error:.1e}" if found.error else "-",
            f"{found.cost_ms:.2f}" if found.cost_ms >= 0.005 else "-",
            found.reason,
            style="" if found.matters else "dim",
        )
    return shown


def setting(plan: Plan) -> list[tuple[str, str]]:
    """What was chosen, as (name, value)."""
    model, dials = plan.model, plan.model.dials
    light = "geometric shadows"
    if dials.diffraction:
        light = f"{dials.reach.rows} rows, {dials.reach.columns} columns"
    chosen = [("method", _METHODS[dials.method])]
    if dials.method == "grid":
        chosen.append(("oversampling", f"{dials.oversampling:g} samples per 8 sensor pixels"))
    else:
        chosen.append(("reach of interference", light))
        chosen.append(("integration step", f"{dials.step * 1e6:.3g} um"))
    samples = dials.wavelengths if any(model.conditions.bandwidth) else 1
    chosen.append(("wavelengths per channel", str(samples)))
    if model.conditions.depth_range:
        chosen.append(("depth layers", str(dials.layers)))
    if model.conditions.off_axis:
        chosen.append(("zones of the field", f"{dials.zones} x {dials.zones}"))
    verdict = "reached" if plan.reached else "NOT reached: this is the most accurate setting"
    return [
        *chosen,
        ("number format", str(dials.dtype).removeprefix("torch.")),
        ("tolerance", f"{plan.tolerance:.1e}, {verdict}"),
        ("predicted error", f"{plan.error:.1e} (relative L2 at the embedding)"),
        ("predicted time", f"{plan.cost.step_ms:.2f} ms for a new mask and {plan.batch} scenes"),
    ]


def explanation(plan: Plan, width: int = 118) -> str:
    """The table and the setting, as plain text."""
    text = io.StringIO()
    console = Console(file=text, width=width, force_terminal=False, color_system=None)
    console.print(table(plan))
    for name, value in setting(plan):
        console.print(f"{name:24} {value}", highlight=False)
    return text.getvalue()
