"""Labelled pictures as somebody keeps them: in folders by class, behind a table, or in arrays."""

import csv
import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from veilcam_optics.pictures import (
    KINDS,
    SUFFIXES,
    PictureError,
    Values,
    as_scene,
    check_reflectances,
    read_picture,
    used_range,
)
from veilcam_training.data.base import UNREADABLE, digest
from veilcam_training.data.folders import PART_NAMES, Part, composed, find_layout, shown
from veilcam_training.errors import TrainingError, require

Pixels = npt.NDArray[np.uint8 | np.int32]

TABLE = "labels.csv"
ARRAYS = "images.npz"
HALVES: tuple[Part, Part] = ("train", "test")
"""Parts that arrays have files of."""
SMALL_NAMED = 3
"""Pictures of a small range that a remark names."""


@dataclass(frozen=True)
class Entry:
    """Facts about one picture."""

    label: str
    """In composed form."""
    group: str | None = None
    """Pictures of one group, of one person, say, are never in two parts."""
    part: Part | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "label", composed(self.label))


@dataclass(frozen=True)
class Header:
    """Facts about one picture that a data set needs before it is reduced."""

    rows: int
    columns: int
    colour: bool
    deep: bool
    """Of more than 8 bits."""
    used: str | None
    """Part of its range that it uses, in words; None for an eighth or more."""


class Collection(ABC):
    """Pictures in a fixed order, and what is said of them."""

    entries: Sequence[Entry]
    deep: bool
    """Whether a picture has more than 8 bits."""

    @property
    @abstractmethod
    def names(self) -> Sequence[str] | None:
        """Path of each picture below the folder; None where they have none."""

    @property
    @abstractmethod
    def size(self) -> tuple[int, int]:
        """Rows and columns that half of the pictures reach."""

    @property
    @abstractmethod
    def colour(self) -> bool:
        """True if a picture has colour."""

    @abstractmethod
    def digest(self) -> str:
        """SHA-256 of everything that the images depend on."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks about the pictures for a person, before a fit."""
        return ()

    @abstractmethod
    def pictures(self, indices: Sequence[int]) -> Iterator[Values]:
        """Read the pictures at ``indices``, upright: (rows, columns) or (rows, columns, 3).

        Raises:
            TrainingError: damaged pictures; all are named.
        """

    def pixels(self, indices: Sequence[int], shape: tuple[int, int], *, colour: bool) -> Pixels:
        """Pictures at ``indices``, cut about their centre to one form and reduced by area.

        Args:
            indices: numbers of the pictures.
            shape: rows and columns to come out.
            colour: three channels, or gray (Rec. 601 luma, as Pillow has it).

        Returns:
            (count, rows, columns), or (count, 3, rows, columns) in colour: int32 up to 65535 if a
            picture has more than 8 bits, else uint8 up to 255.

        Raises:
            TrainingError: damaged pictures; all are named.
        """
        form = (3, *shape) if colour else shape
        white = 65535 if self.deep else 255
        pixels: Pixels = np.empty((len(indices), *form), np.uint8 if white == 255 else np.int32)
        for number, picture in enumerate(self.pictures(indices)):
            pixels[number] = np.rint(as_scene(picture, form) * white)
        return pixels


@dataclass(frozen=True)
class Files(Collection):
    """Picture files."""

    folder: Path
    paths: tuple[Path, ...]
    entries: tuple[Entry, ...]
    found: tuple[str, ...] = ()
    """Remarks of who found them."""

    @cached_property
    def names(self) -> Sequence[str]:
        """Names of their files, with slashes."""
        return [path.relative_to(self.folder).as_posix() for path in self.paths]

    @cached_property
    def _examined(self) -> tuple[Header | str, ...]:
        """Headers of the pictures, decoded whole, or the reasons why one cannot be used."""
        return tuple(map(_examine, self.paths))

    @cached_property
    def _headers(self) -> tuple[Header, ...]:
        self._refuse({i: each for i, each in enumerate(self._examined) if isinstance(each, str)})
        return tuple(each for each in self._examined if isinstance(each, Header))

    def without_damaged(self) -> "Files":
        """Return those that can be used, and remark how many cannot."""
        sound = [i for i, each in enumerate(self._examined) if isinstance(each, Header)]
        damaged = len(self.paths) - len(sound)
        if not damaged:
            return self
        names = [shown(name) for i, name in enumerate(self.names) if i not in set(sound)]
        remark = f"{damaged} damaged pictures are left out: {', '.join(names)}"
        left = replace(
            self,
            paths=tuple(self.paths[i] for i in sound),
            entries=tuple(self.entries[i] for i in sound),
            found=(*self.found, remark),
        )
        vars(left)["_examined"] = tuple(self._examined[i] for i in sound)
        return left

    @property
    def size(self) -> tuple[int, int]:
        """Medians of rows and of columns."""
        rows = float(np.median([each.rows for each in self._headers]))
        columns = float(np.median([each.columns for each in self._headers]))
        return round(rows), round(columns)

    @property
    def colour(self) -> bool:
        """True if one is stored in colour, be it used or not."""
        return any(each.colour for each in self._headers)

    @property
    def deep(self) -> bool:  # type: ignore[override]
        """Return whether a picture has more than 8 bits."""
        return any(each.deep for each in self._headers)

    @property
    def remarks(self) -> tuple[str, ...]:
        """List what was passed over, and how many pictures use little of their range."""
        small = [
            f"{shown(name)} ({each.used})"
            for name, each in zip(self.names, self._headers, strict=True)
            if each.used is not None
        ]
        if not small:
            return self.found
        more = " and others" if len(small) > SMALL_NAMED else ""
        return (
            *self.found,
            f"{len(small)} of {len(self.paths)} pictures use less than an eighth of their range: "
            f"{', '.join(small[:SMALL_NAMED])}{more}: spread their values over it",
        )

    def digest(self) -> str:
        """SHA-256 of names, of what is said of the pictures, and of their files."""
        whole = hashlib.sha256()
        for name, path, entry in zip(self.names, self.paths, self.entries, strict=True):
            line = (name, entry.label, entry.group, entry.part)
            whole.update(f"{line} {digest(path)}\n".encode())
        return whole.hexdigest()

    def pictures(self, indices: Sequence[int]) -> Iterator[Values]:
        """Decode one at a time; damaged ones are told of together, after all were tried."""
        damaged: dict[int, str] = {}
        for index in indices:
            try:
                yield _read(self.paths[index])
            except PictureError as error:
                damaged[index] = str(error)
        self._refuse(damaged)

    def _refuse(self, damaged: dict[int, str]) -> None:
        if damaged:
            named = [f"{shown(self.names[i])} ({reason})" for i, reason in damaged.items()]
            raise TrainingError(
                f"{shown(self.folder)}: {len(damaged)} of {len(self.paths)} pictures cannot be "
                f"read: {', '.join(named)}: get them again, or remove them, or go on without them "
                "(--skip-damaged)"
            )


def _examine(path: Path) -> Header | str:
    try:
        values = _read(path)
    except PictureError as error:
        return str(error)
    rows, columns = values.shape[:2]
    return Header(rows, columns, values.ndim == 3, values.dtype != np.uint8, used_range(values))


def _read(path: Path) -> Values:
    values = read_picture(path)
    check_reflectances(values)
    return values


@dataclass(frozen=True)
class Arrays(Collection):
    """One or two ``.npz`` files."""

    paths: tuple[Path, ...]
    images: npt.NDArray[np.uint8]
    """(count, rows, columns), or (count, rows, columns, 3) in colour."""
    entries: tuple[Entry, ...]
    names: None = None
    deep: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.images.shape[1], self.images.shape[2]

    @property
    def colour(self) -> bool:
        """True if the images have three channels."""
        return self.images.ndim == 4

    def digest(self) -> str:
        """SHA-256 of the files."""
        return digest(*self.paths)

    def pictures(self, indices: Sequence[int]) -> Iterator[Values]:
        """One at a time."""
        yield from self.images[list(indices)]


def is_collection(folder: Path) -> bool:
    """Return True if ``folder`` holds labelled pictures, or a layout that is refused."""
    if not folder.is_dir():
        return False
    if (folder / ARRAYS).is_file() or (folder / TABLE).is_file():
        return True
    if all((folder / f"{part}.npz").is_file() for part in HALVES):
        return True
    try:
        return find_layout(folder) is not None
    except TrainingError:
        return True


def find_collection(folder: Path, *, skip_damaged: bool = False) -> Collection:
    """Find the pictures in ``folder``: arrays, those of a table, or those of folders.

    Args:
        folder: folder of the data set.
        skip_damaged: pictures that cannot be read are left out.

    Raises:
        TrainingError: there are none, or what is said of them cannot be used.
    """
    if (folder / ARRAYS).is_file():
        return _arrays({None: folder / ARRAYS})
    if all((folder / f"{part}.npz").is_file() for part in HALVES):
        return _arrays({part: folder / f"{part}.npz" for part in HALVES})
    files = _table(folder, folder / TABLE) if (folder / TABLE).is_file() else _folders(folder)
    return files.without_damaged() if skip_damaged else files


def _folders(folder: Path) -> Files:
    layout = find_layout(folder)
    if layout is None:
        raise TrainingError(
            f"{shown(folder)}: labelled pictures are missing: put files ({KINDS}) into CLASS/, or "
            f"into train/CLASS/ and test/CLASS/, or name them in {TABLE}, or give arrays in "
            f"{ARRAYS}"
        )
    paths = tuple(path for path, _, _ in layout.pictures)
    entries = tuple(Entry(label, part=part) for _, label, part in layout.pictures)
    return Files(folder, paths, entries, layout.remarks)


def _table(folder: Path, table: Path) -> Files:
    """Pictures named in a CSV file whose first line names its columns."""
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, strict=True)
            columns, rows = set(reader.fieldnames or ()), list(reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise TrainingError(f"{table} cannot be read ({error}): use CSV in UTF-8") from None
    require(
        {"file", "label"} <= columns <= {"file", "label", "group", "part"},
        f"{table} has the columns {', '.join(sorted(columns)) or 'none'}: "
        "use file,label and perhaps group,part",
    )
    paths, entries, seen = [], [], set()
    for number, row in enumerate(rows, start=2):
        name, label, said = row["file"], row["label"], row.get("part") or None
        part = PART_NAMES.get(said.casefold()) if said else None
        require(
            bool(name and label) and None not in row and None not in row.values(),
            f"{table} line {number} has too few or too many values: give one for each column",
        )
        require(
            said is None or part is not None,
            f"{table} line {number}: part is {said!r}: use train, validation or test",
        )
        path = folder / name
        require(
            path.is_file() and path.resolve().is_relative_to(folder.resolve()),
            f"{table} line {number}: {name} is missing in {folder}: put it there, or drop the line",
        )
        require(
            path.suffix.lower() in SUFFIXES,
            f"{table} line {number}: {name} is no picture: use {', '.join(SUFFIXES)}",
        )
        require(path not in seen, f"{table} line {number} repeats {name}: name it once")
        seen.add(path)
        paths.append(path)
        entries.append(Entry(label, row.get("group") or None, part))
    _check_all_or_none(table, "part", [entry.part for entry in entries])
    _check_all_or_none(table, "group", [entry.group for entry in entries])
    parts = {entry.part for entry in entries}
    if "validation" in parts and "test" not in parts:
        tests = [
            replace(each, part="test") if each.part == "validation" else each for each in entries
        ]
        said = ("there is no test part: validation tests",)
        return Files(folder, tuple(paths), tuple(tests), said)
    return Files(folder, tuple(paths), tuple(entries))


def _check_all_or_none(table: Path, column: str, values: Sequence[str | None]) -> None:
    given = sum(value is not None for value in values)
    require(
        given in (0, len(values)),
        f"{table} has a {column} for {given} of {len(values)} pictures: give all of them one",
    )


def _arrays(paths: Mapping[Part | None, Path]) -> Arrays:
    images, entries = [], []
    for part, path in paths.items():
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
                pixels, labels = content["images"], content["labels"]
                groups = content["groups"] if "groups" in content.files else None
        except UNREADABLE:
            raise TrainingError(
                f"{path} is damaged, or lacks images or labels: save it again"
            ) from None
        plain = pixels.ndim == 3 or (pixels.ndim == 4 and pixels.shape[3] == 3)
        require(
            pixels.dtype == np.uint8 and plain and pixels.size > 0,
            f"{path} has images {pixels.dtype} {pixels.shape}: "
            "use uint8 (count, rows, columns) or (count, rows, columns, 3)",
        )
        for name, values in (("labels", labels), ("groups", groups)):
            require(
                values is None or (values.shape == pixels.shape[:1] and values.dtype.kind in "iuU"),
                f"{path} has {name} of another kind or number than its {len(pixels)} images: "
                "use a whole number or a name for each",
            )
        said = [None] * len(labels) if groups is None else [str(group) for group in groups]
        images.append(pixels)
        entries += [
            Entry(str(label), group, part) for label, group in zip(labels, said, strict=True)
        ]
    require(
        len({pixels.shape[1:] for pixels in images}) == 1,
        f"{' and '.join(str(path) for path in paths.values())} have images of "
        f"{' and '.join(str(pixels.shape[1:]) for pixels in images)}: use one size",
    )
    return Arrays(tuple(paths.values()), np.concatenate(images), tuple(entries))
