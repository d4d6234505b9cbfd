"""A table of the paper: which cells it has, and parts of it that may be asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product, starmap

from veilcam_training.classifiers import Task, make_layers
from veilcam_training.encoders import ENCODERS
from veilcam_training.errors import TrainingError
from veilcam_training.job import Settings
from veilcam_training.tables.place import Column, Place, Row

READINGS = ("area", "point")


@dataclass(frozen=True)
class Part:
    """Which cells of a table are wanted; None for those that it has of its own accord.

    What is named twice is run once.
    """

    encoders: Sequence[str] | None = None
    classifiers: Sequence[str] | None = None
    embeddings: Sequence[str] | None = None
    readings: Sequence[str] | None = None
    datasets: Sequence[str] | None = None
    changes: Sequence[str] | None = None


@dataclass(frozen=True)
class Table:
    """Every combination of its parts.

    ``classifiers`` are the paper's; others may be asked for. Of its own accord it has the area
    reading for every encoder, and beside that of a learned mask the paper's sampling.
    """

    name: str
    title: str
    datasets: tuple[str, ...]
    classifiers: tuple[str, ...]
    embeddings: tuple[str, ...]
    changes: tuple[str, ...] = ("none",)
    encoders: tuple[str, ...] = tuple(ENCODERS)
    readings: tuple[str, ...] = READINGS

    def places(self, part: Part = Part(), *, psf: bool = False) -> tuple[Place, ...]:
        """The places of ``part`` of the table, in the order in which they are run.

        Args:
            part: what is wanted.
            psf: True if there is a measured point spread function. Without one the encoder
                ``fixed_measured`` is left out, unless it is asked for by name.

        Raises:
            TrainingError: a part that the table does not have.
        """
        encoders = part.encoders
        if encoders is None and not psf:
            encoders = [name for name in self.encoders if name != "fixed_measured"]
        chosen = replace(part, encoders=encoders)
        wanted = {
            field.name: self._choose(field.name, getattr(chosen, field.name))
            for field in fields(chosen)
            if field.name != "classifiers"
        }
        places = []
        for data, change, classifier, encoder, embedding, reading in product(
            wanted["datasets"],
            wanted["changes"],
            self._classifiers(part.classifiers),
            wanted["encoders"],
            wanted["embeddings"],
            wanted["readings"],
        ):
            sampled = reading == "point"
            if sampled and encoder == "digital":
                continue  # there is no sensor to sample
            if sampled and part.readings is None and encoder != "learned":
                continue
            places.append(Place(Row(classifier, encoder, reading), Column(data, change, embedding)))
        if not places:
            raise TrainingError(
                f"table {self.name!r} has no such cells: digital has no reading 'point'"
            )
        return tuple(places)

    def holds(self, settings: Settings) -> bool:
        """True if a fit with ``settings`` belongs into this table."""
        return (
            settings.data in self.datasets
            and settings.change in self.changes
            and settings.encoder in self.encoders
            and settings.embedding in self.embeddings
        )

    def rows(self, finished: Sequence[Row]) -> Iterator[Row]:
        """The table's rows in order: its own with the area reading, and those of ``finished``."""
        classifiers = dict.fromkeys((*self.classifiers, *(row.classifier for row in finished)))
        for row in starmap(Row, product(classifiers, self.encoders, self.readings)):
            own = row.classifier in self.classifiers and row.reading == "area"
            if own or row in finished:
                yield row

    def columns(self) -> tuple[Column, ...]:
        """The table's columns in order."""
        return tuple(starmap(Column, product(self.datasets, self.changes, self.embeddings)))

    def column_title(self, column: Column) -> str:
        """That in a column's name which not all columns share, e.g. ``24x32``."""
        parts = zip(column, (self.datasets, self.changes, self.embeddings), strict=True)
        names = [name for name, known in parts if len(known) > 1]
        return " ".join("original" if name == "none" else name for name in names)

    def _choose(self, kind: str, wanted: Sequence[str] | None) -> Sequence[str]:
        known: tuple[str, ...] = getattr(self, kind)
        if wanted is None:
            return known
        for name in wanted:
            if name not in known:
                raise TrainingError(
                    f"table {self.name!r} has no {name!r} among its {kind}: "
                    f"use one or more of {','.join(known)}"
                )
        return tuple(dict.fromkeys(wanted))

    def _classifiers(self, wanted: Sequence[str] | None) -> Sequence[str]:
        if wanted is None:
            return self.classifiers
        for name in wanted:  # an unknown one is refused before anything is run
            make_layers(name, Task(1, 24, 32, 10, rectified=False, normalisation="per_pixel"))
        return tuple(dict.fromkeys(wanted))
