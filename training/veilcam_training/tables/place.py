"""Where a cell stands in a table: its row, its column, and what the paper has there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Self

from veilcam_training.job import Settings
from veilcam_training.tables.paper import load_paper


class Row(NamedTuple):
    """What one row of a table has in common."""

    classifier: str
    encoder: str
    reading: str


class Column(NamedTuple):
    """What one column of a table has in common."""

    data: str
    change: str
    embedding: str


@dataclass(frozen=True)
class Place:
    """A row and a column, by the names of the settings of a fit."""

    row: Row
    column: Column

    @classmethod
    def of(cls, settings: Settings) -> Self:
        """Where a fit with ``settings`` stands."""
        return cls(
            Row(settings.classifier, settings.encoder, settings.reading),
            Column(settings.data, settings.change, settings.embedding),
        )

    @property
    def title(self) -> str:
        """What is compared, e.g. ``mnist_FC800_learned_24x32_shift``."""
        row, column = self.row, self.column
        parts = [column.data, row.classifier, row.encoder, column.embedding]
        return "_".join(parts if column.change == "none" else [*parts, column.change])

    @property
    def name(self) -> str:
        """The title, with ``_point`` for the paper's sampling of the sensor."""
        return self.title + ("_point" if self.row.reading == "point" else "")

    @property
    def figure(self) -> str:
        """The name of its test accuracy in a record of figures."""
        row, (data, change, embedding) = self.row, self.column
        classifier = row.classifier.lower() if data == "fashion" else row.classifier
        name = f"{data}_{classifier}_{row.encoder}_{embedding}"
        if change != "none":
            name = f"robust_{change}_{row.classifier}_{row.encoder}"
        return name + ("_point" if row.reading == "point" else "")

    @property
    def paper(self) -> float | None:
        """Test accuracy in the paper [percent], or None where it has none."""
        return load_paper().accuracy.get(self.title)
