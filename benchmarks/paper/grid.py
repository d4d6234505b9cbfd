"""Tables of fits by name, the paper's and ours of the same kind, and the cells in them."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib.resources import files
from itertools import product, starmap
from typing import NamedTuple, Self

from veilcam_training.config.settings import FitSettings
from veilcam_training.encoders import ENCODERS
from veilcam_training.errors import require
from veilcam_training.models.classifiers import SceneTask, Task, make_layers, reads_scenes


@dataclass(frozen=True)
class Paper:
    """Test accuracies [percent] and where they stand."""

    source: str
    accuracy: Mapping[str, float]


@cache
def load_paper() -> Paper:
    """The numbers of ``paper.json``."""
    content = json.loads((files(__package__) / "paper.json").read_text())
    return Paper(content["source"], content["accuracy"])


CAMERAS = (*ENCODERS, "hidden", "fresh")
"""Encoders, of which ``learned`` has no bound, as the paper's; ``hidden`` is learned within the
bound of a fit, and ``fresh`` reads behind masks that are drawn anew."""
SCENE_CAMERAS: Mapping[str, str] = {
    "coded_aperture": "coded",
    "fixed_measured": "measured",
    "fixed_simulated": "fixed",
    "learned": "open",
    "hidden": "learned",
}
"""Names of cameras in the figures of scene classifiers, where they are others."""
HEADLINES: Mapping[str, str] = {
    "faces-smiling_open_24x32@0.1": "faces_smiling_fill",
    "faces-gender_open_24x32@0.1": "faces_gender_fill",
    "faces-glasses_open_24x32@0.1": "faces_glasses_fill",
    "fashion_learned_24x32": "fashion_24x32",
    "robust_shift_CNN16_hidden": "mnist_shift",
    "mnist_fresh_24x32": "fresh_mnist_24x32",
    "mnist_fresh_12x16": "fresh_mnist_12x16",
    "mnist_fresh_3x4": "fresh_mnist_3x4",
}
"""Figures with a name of their own."""
PAPER_HEADS: Mapping[str, str] = {"mnist": "FC800", "fashion": "FC800", "cifar10": "VGG11"}
"""The paper's best classifier of each data set, which a scene classifier stands beside."""


class Row(NamedTuple):
    """Classifier, camera (see :data:`CAMERAS`) and binning of one row of a table."""

    classifier: str
    encoder: str
    binning: str


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
    def of(cls, settings: FitSettings) -> Self:
        """Where a fit with ``settings`` stands."""
        camera = settings.encoder
        if settings.fresh is not None:
            camera = "fresh"
        elif camera == "learned" and settings.hidden:
            camera = "hidden"
        return cls(
            Row(settings.classifier, camera, settings.binning),
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
        return self.title + ("_point" if self.row.binning == "point" else "")

    @property
    def figure(self) -> str:
        """The name of its test accuracy in a record of figures."""
        row, (data, change, embedding) = self.row, self.column
        if reads_scenes(row.classifier):
            name = f"{data}_{SCENE_CAMERAS.get(row.encoder, row.encoder)}_{embedding}"
            name += "" if change == "none" else f"_{change}"
            return HEADLINES.get(name, name)
        classifier = row.classifier.lower() if data == "fashion" else row.classifier
        name = f"{data}_{classifier}_{row.encoder}_{embedding}"
        if change != "none":
            name = f"robust_{change}_{row.classifier}_{row.encoder}"
        return HEADLINES.get(name, name) + ("_point" if row.binning == "point" else "")

    @property
    def paper(self) -> float | None:
        """Test accuracy in the paper [percent], or None where it has none.

        A scene classifier stands beside the paper's best, a bounded mask beside its learned one,
        and any fill beside its whole pixels.
        """
        row, column = self.row, self.column
        classifier = row.classifier
        if reads_scenes(classifier):
            classifier = PAPER_HEADS.get(column.data, classifier)
        camera = "learned" if row.encoder == "hidden" else row.encoder
        size = column.embedding.partition("@")[0]
        place = Place(
            row._replace(classifier=classifier, encoder=camera), column._replace(embedding=size)
        )
        return load_paper().accuracy.get(place.title)


@dataclass(frozen=True)
class Cell:
    """One fit of a table."""

    settings: FitSettings

    @property
    def place(self) -> Place:
        """Where it stands."""
        return Place.of(self.settings)

    @property
    def name(self) -> str:
        """Of its place and its seed, unless that is 0: no two cells of a table share a name."""
        return self.place.name + (f"_seed{self.settings.seed}" if self.settings.seed else "")


BINNINGS = ("area", "point")


@dataclass(frozen=True)
class Part:
    """Which cells of a table are wanted; None for those that it has of its own accord.

    What is named twice is run once.
    """

    encoders: Sequence[str] | None = None
    classifiers: Sequence[str] | None = None
    embeddings: Sequence[str] | None = None
    binnings: Sequence[str] | None = None
    datasets: Sequence[str] | None = None
    changes: Sequence[str] | None = None


@dataclass(frozen=True)
class Table:
    """Every combination of its parts.

    ``classifiers`` are the paper's; others may be asked for. Of its own accord it has the area
    binning for every encoder but a measured one, and beside that of a learned mask the paper's
    sampling. Other cameras, and embeddings with a fill, are asked for by name.
    """

    name: str
    title: str
    datasets: tuple[str, ...]
    classifiers: tuple[str, ...]
    embeddings: tuple[str, ...]
    changes: tuple[str, ...] = ("none",)
    encoders: tuple[str, ...] = CAMERAS
    binnings: tuple[str, ...] = BINNINGS

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
        if encoders is None:
            encoders = [name for name in ENCODERS if psf or name != "fixed_measured"]
        chosen = replace(part, encoders=encoders)
        wanted = {
            field.name: self._choose(field.name, getattr(chosen, field.name))
            for field in fields(chosen)
            if field.name != "classifiers"
        }
        places = []
        for data, change, classifier, encoder, embedding, binning in product(
            wanted["datasets"],
            wanted["changes"],
            self._classifiers(part.classifiers),
            wanted["encoders"],
            wanted["embeddings"],
            wanted["binnings"],
        ):
            sampled = binning == "point"
            if sampled and encoder in ("digital", "hidden", "fresh"):
                continue  # there is no sensor to sample, or a device that averages
            if sampled and part.binnings is None and encoder != "learned":
                continue
            places.append(Place(Row(classifier, encoder, binning), Column(data, change, embedding)))
        require(
            len(places) > 0,
            f"table {self.name!r} has no such cells: binning 'point' is for cameras with a sensor, "
            "and for no bound",
        )
        return tuple(places)

    def holds(self, settings: FitSettings) -> bool:
        """True if a fit with ``settings`` belongs into this table."""
        return (
            settings.data in self.datasets
            and settings.change in self.changes
            and settings.embedding.partition("@")[0] in self.embeddings
        )

    def rows(self, finished: Sequence[Row]) -> Iterator[Row]:
        """The table's rows in order: its own with the area binning, and those of ``finished``."""
        classifiers = dict.fromkeys((*self.classifiers, *(row.classifier for row in finished)))
        for row in starmap(Row, product(classifiers, self.encoders, self.binnings)):
            own = row.classifier in self.classifiers and row.binning == "area"
            own = own and row.encoder in ENCODERS
            if own or row in finished:
                yield row

    def columns(self, finished: Sequence[Column] = ()) -> tuple[Column, ...]:
        """The table's columns in order, and then those of ``finished`` with a fill."""
        own = starmap(Column, product(self.datasets, self.changes, self.embeddings))
        return tuple(dict.fromkeys((*own, *finished)))

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
            require(
                (name.partition("@")[0] if kind == "embeddings" else name) in known,
                f"table {self.name!r} has no {name!r} among its {kind}: "
                f"use one or more of {','.join(known)}",
            )
        return tuple(dict.fromkeys(wanted))

    def _classifiers(self, wanted: Sequence[str] | None) -> Sequence[str]:
        if wanted is None:
            return self.classifiers
        for name in wanted:  # an unknown one is refused before anything is run
            estimate = (SceneTask(1, 28, 28, 10), ())
            task = Task(1, 24, 32, 10, rectified=False, normalisation="per_pixel")
            make_layers(name, replace(task, estimate=estimate))
        return tuple(dict.fromkeys(wanted))


GRAY_SIZES = ("24x32", "12x16", "6x8", "3x4")

TABLES: Mapping[str, Table] = {
    table.name: table
    for table in (
        Table("mnist", "Handwritten digits (MNIST)", ("mnist",), ("LR", "FC800"), GRAY_SIZES),
        Table("fashion", "Clothes (Fashion-MNIST)", ("fashion",), ("LR", "FC800"), GRAY_SIZES),
        Table(
            "robust",
            "Digits that are moved, scaled, turned and tilted (MNIST)",
            ("mnist",),
            ("FC800",),
            ("24x32",),
            changes=("none", "shift", "rescale", "rotate", "perspective"),
        ),
        Table(
            "faces",
            "Drawn faces",
            ("faces-gender", "faces-smiling", "faces-glasses"),
            ("FC800",),
            ("24x32", "3x4"),
        ),
        Table(
            "celeba",
            "Photographs of faces (CelebA)",
            ("celeba-gender", "celeba-smiling"),
            ("FC800",),
            ("24x32", "3x4"),
        ),
        Table(
            "cifar10",
            "Photographs of objects in colour (CIFAR-10)",
            ("cifar10",),
            ("VGG11",),
            ("27x36", "13x17", "6x8", "3x4"),
        ),
        Table("own", "Own pictures", ("image-folder",), ("LR", "FC800"), GRAY_SIZES),
    )
}


def find_table(name: str) -> Table:
    """Table ``name``.

    Raises:
        TrainingError: an unknown name.
    """
    require(name in TABLES, f"table {name!r} is unknown: use one of {', '.join(TABLES)}")
    return TABLES[name]
