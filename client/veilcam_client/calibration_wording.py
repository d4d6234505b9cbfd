"""Calibrations in words, for a terminal."""

from __future__ import annotations

from veilcam_client.calibration_models import CalibrationRecord, CalibrationRun, Quantity

_ROWS = (
    ("settling", "settling_s", 1e3, "ms"),
    ("black level", "black_level", 1.0, ""),
    ("gain", "gain", 1.0, ""),
    ("full scale", "full_scale", 1.0, ""),
    ("gamma", "gamma", 1.0, ""),
    ("contrast floor", "contrast_floor", 1.0, ""),
    ("dead lines pass", "dead_transmittance", 1.0, ""),
    ("shift along y", "shift_y_m", 1e6, "um"),
    ("shift along x", "shift_x_m", 1e6, "um"),
    ("rotation", "rotation_rad", 1e3, "mrad"),
    ("distance error", "distance_error_m", 1e6, "um"),
    ("stray light", "stray_light", 1e2, "%"),
)
"""Name, field of the record, factor and unit."""


def table(record: CalibrationRecord) -> list[tuple[str, ...]]:
    """All measured values, one row each; what dead lines pass only where there are any."""
    dead = record.dead_rows or record.dead_columns
    return [
        _row(name, getattr(record, field), factor, unit)
        for name, field, factor, unit in _ROWS
        if dead or field != "dead_transmittance"
    ]


def record_in_words(record: CalibrationRecord) -> str:
    """All measured values as a table, dead lines, and how well it fits."""
    rows = [("", "value", "uncertainty", "residual"), *table(record)]
    lines = [f"{name:<20}{value:>10}{spread:>13}{rest:>10}" for name, value, spread, rest in rows]
    for name, dead in (("rows", record.dead_rows), ("columns", record.dead_columns)):
        if dead:
            lines.append(f"dead {name}: {', '.join(map(str, dead))}")
    unseen = "readings of the lamp behind patterns that no fit has seen are off by"
    lines.append(f"{unseen} {100 * record.psf_residual:.2g} %")
    lines.append(f"the light drifted by {100 * record.drift:.2g} %")
    return "\n".join(lines)


def run_in_words(run: CalibrationRun) -> str:
    """How a calibration goes on, in one line."""
    if run.stage in ("waiting", "failed"):
        return f"{run.stage}  {run.instruction or run.detail}"
    scene = f" of {run.scene}" if run.scene else ""
    return f"{run.stage}  {run.exposures} of {run.total} exposures{scene}"


def _row(name: str, quantity: Quantity, factor: float, unit: str) -> tuple[str, ...]:
    """Name, value, uncertainty and residual as a person reads them."""
    return (
        f"{name} [{unit}]" if unit else name,
        f"{factor * quantity.value:.4g}",
        f"{factor * quantity.uncertainty:.2g}",
        f"{100 * quantity.residual:.2g} %",
    )
