"""Chart of a calibration, ``calibration.png``: measured curves, fits and residuals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from veilcam_client.cli.format import table
from veilcam_client.wire.calibration import CalibrationRecord
from veilcam_server.calibration.measurements import SETTLED, Settling
from veilcam_server.calibration.procedure import Calibrated
from veilcam_server.calibration.rig import Values

PAPER, INK, FAINT, MEASURED, FITTED = "#0f1216", "#e8e6e1", "#7d8790", "#7fd1ae", "#f2a86b"


def write_picture(path: Path, found: Calibrated) -> None:
    """Draw the curves of a calibration; raises ``OSError``."""
    figure = Figure(figsize=(12, 9.6), facecolor=PAPER, dpi=120)
    curves = figure.add_gridspec(
        2, 2, left=0.06, right=0.97, top=0.87, bottom=0.42, hspace=0.42, wspace=0.16
    )
    below = figure.add_gridspec(
        1, 4, width_ratios=(1, 1, 1, 2.1), left=0.06, right=0.97, top=0.31, bottom=0.04, wspace=0.13
    )
    record, result = found.record, found.result
    figure.text(
        0.06, 0.955, "The camera measured with itself", color=INK, fontsize=18, weight="bold"
    )
    figure.text(
        0.06,
        0.93,
        f"{record.display} and {record.sensor}, {'simulated' if record.simulated else 'real'}, "
        f"{record.taken_at:%Y-%m-%d %H:%M} UTC, exposure {1000 * record.exposure_s:g} ms",
        color=FAINT,
        fontsize=10,
    )
    _settling(figure.add_subplot(curves[0, 0]), result.measured.settling)
    _staircase(figure.add_subplot(curves[0, 1]), found)
    _lines(figure.add_subplot(curves[1, 0]), "rows opened alone", result.measured.lines.rows)
    _lines(figure.add_subplot(curves[1, 1]), "columns opened alone", result.measured.lines.columns)
    # Behind a held-out pattern, the lamp shows the binned point spread function.
    top = float(np.max(result.lamp))
    _image(figure.add_subplot(below[0]), "lamp, as read", result.lamp / top)
    _image(
        figure.add_subplot(below[1]),
        f"predicted: {100 * record.psf_residual:.2g} % off",
        result.lamp_predicted / top,
    )
    _image(
        figure.add_subplot(below[2]),
        "difference x 10",
        0.5 + 10 * (result.lamp - result.lamp_predicted) / top,
    )
    _table(figure.add_subplot(below[3]), record)
    figure.savefig(path, facecolor=PAPER)


def _styled(axes: Axes, title: str) -> None:
    axes.set_facecolor(PAPER)
    axes.set_title(title, color=INK, fontsize=10.5, loc="left")
    axes.tick_params(colors=FAINT, labelsize=8)
    for spine in axes.spines.values():
        spine.set_color("#2a3038")


def _settling(axes: Axes, settling: Settling) -> None:
    _styled(axes, f"settling: within 2 % after {1000 * settling.seconds:.3g} ms")
    for moments, colour, name in (
        (settling.rising, MEASURED, "opaque to open"),
        (settling.falling, FITTED, "open to opaque"),
    ):
        start = [1000 * moment.started for moment in moments]
        axes.plot(start, [m.mean for m in moments], "o-", color=colour, ms=3, lw=0.8, label=name)
    axes.axhspan(1 - SETTLED, 1 + SETTLED, color=FAINT, alpha=0.35, lw=0)
    axes.axvline(1000 * settling.seconds, color=INK, lw=0.8, ls=":")
    axes.set_xlabel("start of the exposure after the last byte [ms]", color=FAINT, fontsize=8.5)
    axes.set_ylabel("share of the step", color=FAINT, fontsize=8.5)
    axes.legend(loc="lower right", fontsize=8, labelcolor=FAINT, frameon=False)


def _staircase(axes: Axes, found: Calibrated) -> None:
    staircase, response = found.result.measured.staircase, found.result.response
    _styled(axes, f"panel: gamma {response.gamma:.3f}, contrast floor {response.floor:.3f}")
    fine = np.linspace(0, 1, 200)
    # Dead lines add the same light to every step.
    lowest = float(staircase.light[0] - response.light(staircase.weights[:1])[0])
    extra = max(0.0, lowest) if found.record.dead_rows or found.record.dead_columns else 0.0
    axes.plot(fine, (response.light(fine) + extra) / response.scale, color=FITTED, lw=1.2)
    axes.plot(staircase.weights, staircase.light / response.scale, "o", color=MEASURED, ms=4)
    axes.set_xlabel("level, over the highest", color=FAINT, fontsize=8.5)
    axes.set_ylabel("light, over the open panel's", color=FAINT, fontsize=8.5)


def _lines(axes: Axes, title: str, shares: Values) -> None:
    dead = shares < 0.5
    _styled(axes, f"{title}: {dead.sum()} dead" if dead.any() else f"{title}: all obey")
    axes.bar(np.arange(len(shares)), shares, color=np.where(dead, FITTED, MEASURED), width=0.8)
    axes.axhline(0.5, color=INK, lw=0.8, ls=":")
    axes.set_ylim(min(0.0, float(np.min(shares))), 1.15 * float(np.max(shares)))
    axes.set_ylabel("light, over expected", color=FAINT, fontsize=8.5)


def _image(axes: Axes, title: str, values: Values) -> None:
    _styled(axes, title)
    axes.imshow(values, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
    axes.set_xticks([])
    axes.set_yticks([])


def _table(axes: Axes, record: CalibrationRecord) -> None:
    axes.axis("off")
    rows = [("", "value", "uncertainty", "residual"), *table(record)]
    for number, row in enumerate(rows):
        height = 1.04 - number * 1.06 / len(rows)
        for place, text in zip((0.0, 0.6, 0.82, 1.0), row, strict=True):
            axes.text(
                place,
                height,
                text,
                color=FAINT if number == 0 else INK,
                fontsize=8.5,
                ha="left" if place == 0 else "right",
                va="top",
                transform=axes.transAxes,
            )
