"""Finished cells that differ in nothing but their seed: one number is their mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from veilcam_training.errors import TrainingError
from veilcam_training.tables.place import Place
from veilcam_training.tables.result import CellResult


def by_place(results: Sequence[CellResult]) -> Mapping[Place, tuple[CellResult, ...]]:
    """``results`` by their place in a table, the least seed first.

    Raises:
        TrainingError: two of one place differ in more than their seed.
    """
    places: dict[Place, list[CellResult]] = {}
    for result in sorted(results, key=lambda result: result.settings.seed):
        group = places.setdefault(result.cell.place, [])
        group.append(result)
        first = group[0].settings
        if result.settings.model_copy(update={"seed": first.seed}) != first:
            raise TrainingError(
                f"cells {group[0].cell.name} and {result.cell.name} differ in more than their "
                "seed, so they have no mean: move one of their folders to another --work"
            )
    return {place: tuple(group) for place, group in places.items()}
