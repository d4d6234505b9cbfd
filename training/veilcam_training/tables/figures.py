"""Test accuracies of finished cells in the record of figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import mean

from veilcam_training.figures import Origin, record_figures
from veilcam_training.tables.result import CellResult
from veilcam_training.tables.seeds import by_place


def record_cells(path: Path, results: Sequence[CellResult]) -> None:
    """Write test accuracies [percent] into the record at ``path``.

    Several seeds of one cell give their mean. Each figure has the command, commit, date and machine
    of the cell; of several, every command and commit, and the last one's date and machine.
    ``robust_<change>`` is that of the classifier which validates best behind a learned mask.

    Raises:
        TrainingError: see :func:`veilcam_training.tables.seeds.by_place`; or what is at ``path`` is
            no such record.
    """
    by_name = {place.figure: group for place, group in by_place(results).items()}
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
        record_figures(path, {name: round(percent, 2)}, origin=_origin(group))


def _origin(group: Sequence[CellResult]) -> Origin:
    origins = sorted((result.origin for result in group), key=lambda origin: origin.date)
    return replace(
        origins[-1],
        command="; ".join(dict.fromkeys(origin.command for origin in origins)),
        commit=", ".join(dict.fromkeys(origin.commit for origin in origins)),
    )


def _validation_accuracy(group: Sequence[CellResult]) -> float:
    return mean(result.validation_accuracy for result in group)
