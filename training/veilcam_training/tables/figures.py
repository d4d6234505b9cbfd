"""Test accuracies of finished cells in the record of figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import mean

from veilcam_training.figures import record_figures
from veilcam_training.tables.result import CellResult


def record_cells(path: Path, results: Sequence[CellResult]) -> None:
    """Write test accuracies [percent] into the record at ``path``.

    Several seeds of one cell give their mean. Each figure has the command, commit, date and machine
    of the cell, of the last one if there are several. ``robust_<change>`` is that of the classifier
    which validates best behind a learned mask.
    """
    by_name: dict[str, list[CellResult]] = {}
    for result in results:
        by_name.setdefault(result.cell.place.figure, []).append(result)
    for change in {result.settings.change for result in results} - {"none"}:
        learned = [
            group
            for group in by_name.values()
            if (settings := group[0].settings).change == change
            and (settings.encoder, settings.reading) == ("learned", "area")
        ]
        if learned:
            by_name[f"robust_{change}"] = max(learned, key=_validation_accuracy)
    for name, group in by_name.items():
        percent = 100 * mean(result.test_accuracy for result in group)
        last = max(group, key=lambda result: result.origin.date)
        record_figures(path, {name: round(percent, 2)}, origin=last.origin)


def _validation_accuracy(group: Sequence[CellResult]) -> float:
    return mean(result.validation_accuracy for result in group)
