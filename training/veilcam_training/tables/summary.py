"""Finished cells by their place in a table; several seeds of one are their mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import mean, stdev

from veilcam_training.tables.place import Column, Place, Row
from veilcam_training.tables.result import CellResult
from veilcam_training.tables.seeds import by_place
from veilcam_training.tables.table import Table


@dataclass(frozen=True)
class Entry:
    """What stands in one place of a table; accuracies and differences in percent."""

    place: Place
    results: tuple[CellResult, ...]
    """One for each seed, the least first; none if it has not been run."""

    @property
    def test(self) -> float | None:
        """Mean test accuracy."""
        return 100 * mean(r.test_accuracy for r in self.results) if self.results else None

    @property
    def validation(self) -> float | None:
        """Mean validation accuracy."""
        return 100 * mean(r.validation_accuracy for r in self.results) if self.results else None

    @property
    def spread(self) -> float | None:
        """Standard deviation of the test accuracy over the seeds, if there are several."""
        if len(self.results) < 2:
            return None
        return 100 * stdev(result.test_accuracy for result in self.results)

    @property
    def paper(self) -> float | None:
        """The paper's test accuracy."""
        return self.place.paper

    @property
    def difference(self) -> float | None:
        """Test accuracy less the paper's, to the digit that the paper gives."""
        if self.test is None or self.paper is None:
            return None
        return round(self.test - self.paper, 1) + 0.0  # no -0.0


class Summary:
    """A table with what is finished of it.

    Args:
        table: says what its rows and columns are.
        results: cells that belong to it.

    Raises:
        TrainingError: see :func:`veilcam_training.tables.seeds.by_place`.
    """

    def __init__(self, table: Table, results: Sequence[CellResult]) -> None:
        self.table = table
        places = by_place(results)
        self.columns = table.columns()
        self.rows = tuple(table.rows([place.row for place in places]))
        self._entries = [
            [
                Entry(Place(row, column), places.get(Place(row, column), ()))
                for column in self.columns
            ]
            for row in self.rows
        ]

    def entries(self, row: Row) -> list[Entry]:
        """What stands in ``row``, column by column."""
        return self._entries[self.rows.index(row)]

    def finished(self) -> list[Entry]:
        """Every place that has been run, row by row."""
        return [entry for row in self._entries for entry in row if entry.results]

    def find(self, row: Row, column: Column) -> Entry | None:
        """What stands in ``row`` and ``column``, if there are such and it has been run."""
        for entry in self.finished():
            if entry.place == Place(row, column):
                return entry
        return None
