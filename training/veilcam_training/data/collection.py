"""Labelled pictures as somebody keeps them: in folders by class, behind a table, or in arrays."""

import csv
import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageOps

from veilcam_training.data.base import UNREADABLE, digest
from veilcam_training.errors import TrainingError, require

Part = Literal["train", "test"]
Pixels = npt.NDArray[np.uint8]

SUFFIXES = (".png", ".jpg", ".jpeg")
TABLE = "labels.csv"
ARRAYS = "images.npz"
PARTS: tuple[Part, Part] = ("train", "test")
ORIENTATION = 0x0112
"""EXIF's number of it; from 5 on, rows and columns change places."""
NAMED = 10
"""Damaged files that a refusal names; of more it says how many there are."""
GRAY_MODES = ("1", "L", "LA", "I", "I;16", "I;16B", "F")
"""Pillow's modes of pictures without colour."""


@dataclass(frozen=True)
class Entry:
    """Facts about one picture."""

    label: str
    group: str | None = None
    """Pictures of one group, of one person, say, are never in two parts."""
    part: Part | None = None


class Collection(ABC):
    """Pictures in a fixed order, and what is said of them."""

    entries: Sequence[Entry]

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

    @abstractmethod
    def pictures(self, indices: Sequence[int]) -> Iterator[Image.Image]:
        """Read the pictures at ``indices``, upright, each in mode L or RGB.

        Raises:
            TrainingError: damaged pictures; the first are named.
        """

    def pixels(self, indices: Sequence[int], shape: tuple[int, int], *, colour: bool) -> Pixels:
        """Pictures at ``indices``, cut about their centre to one form and reduced by area.

        Args:
            indices: numbers of the pictures.
            shape: rows and columns to come out.
            colour: three channels, or gray (Rec. 601 luma, as Pillow has it).

        Returns:
            (count, rows, columns), or (count, 3, rows, columns) in colour.

        Raises:
            TrainingError: damaged pictures; the first are named.
        """
        rows, columns = shape
        planes = [
            np.asarray(
                ImageOps.fit(
                    picture.convert("RGB" if colour else "L"),
                    (columns, rows),
                    Image.Resampling.BOX,
                )
            )
            for picture in self.pictures(indices)
        ]
        stacked = np.stack(planes) if planes else np.zeros((0, *shape, *(3,) * colour), np.uint8)
        return np.ascontiguousarray(stacked.transpose(0, 3, 1, 2)) if colour else stacked


@dataclass(frozen=True)
class Files(Collection):
    """PNG and JPEG files."""

    folder: Path
    paths: tuple[Path, ...]
    entries: tuple[Entry, ...]

    @cached_property
    def names(self) -> Sequence[str]:
        """Names of their files, with slashes."""
        return [path.relative_to(self.folder).as_posix() for path in self.paths]

    @cached_property
    def _headers(self) -> tuple[tuple[int, int, bool], ...]:
        """Rows, columns, and whether there is colour, of each; nothing is decoded."""
        found, damaged = [], []
        for path in self.paths:
            try:
                with Image.open(path) as picture:
                    # Of a PNG, its orientation is behind the pixels: it would be decoded for it.
                    jpeg = picture.format == "JPEG"
                    turned = jpeg and picture.getexif().get(ORIENTATION, 1) >= 5
                    columns, rows = picture.size[::-1] if turned else picture.size
                    found.append((rows, columns, picture.mode not in GRAY_MODES))
            except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
                damaged.append((path, error))
        self._refuse(damaged)
        return tuple(found)

    @property
    def size(self) -> tuple[int, int]:
        """Medians of rows and of columns."""
        rows, columns, _ = zip(*self._headers, strict=True)
        return round(float(np.median(rows))), round(float(np.median(columns)))

    @property
    def colour(self) -> bool:
        """True if one is stored in colour, be it used or not."""
        return any(colour for _, _, colour in self._headers)

    def digest(self) -> str:
        """SHA-256 of names, of what is said of the pictures, and of their files."""
        whole = hashlib.sha256()
        for name, path, entry in zip(self.names, self.paths, self.entries, strict=True):
            line = (name, entry.label, entry.group, entry.part)
            whole.update(f"{line} {digest(path)}\n".encode())
        return whole.hexdigest()

    def pictures(self, indices: Sequence[int]) -> Iterator[Image.Image]:
        """Decode one at a time; damaged ones are told of together, after all were tried."""
        damaged: list[tuple[Path, Exception]] = []
        for index in indices:
            path = self.paths[index]
            try:
                with Image.open(path) as picture:
                    upright = _flat(ImageOps.exif_transpose(picture))
            except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
                damaged.append((path, error))
            else:
                yield upright
        self._refuse(damaged)

    def _refuse(self, damaged: Sequence[tuple[Path, Exception]]) -> None:
        if not damaged:
            return
        named = [
            f"{path.relative_to(self.folder)} ({str(error).replace(str(path), 'file')})"
            for path, error in damaged[:NAMED]
        ]
        more = f" and {len(damaged) - NAMED} more" if len(damaged) > NAMED else ""
        raise TrainingError(
            f"{self.folder}: {len(damaged)} of {len(self.paths)} pictures cannot be read: "
            f"{', '.join(named)}{more}: get them again, or remove them"
        )


@dataclass(frozen=True)
class Arrays(Collection):
    """One or two ``.npz`` files."""

    paths: tuple[Path, ...]
    images: Pixels
    """(count, rows, columns), or (count, rows, columns, 3) in colour."""
    entries: tuple[Entry, ...]
    names: None = None

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

    def pictures(self, indices: Sequence[int]) -> Iterator[Image.Image]:
        """One at a time."""
        for index in indices:
            yield Image.fromarray(self.images[index])


def _flat(picture: Image.Image) -> Image.Image:
    """``picture`` in mode L or RGB: what is transparent is black, 16 bits become 8."""
    if picture.mode.startswith("I"):
        values = np.asarray(picture).astype(np.int64)
        return Image.fromarray((np.clip(values, 0, 65535) // 257).astype(np.uint8))
    if picture.mode in GRAY_MODES and "transparency" not in picture.info:
        if picture.mode == "LA":
            picture = picture.convert("RGBA")
        else:
            return picture.convert("L")
    if picture.mode in ("RGBA", "LA", "PA") or "transparency" in picture.info:
        whole = picture.convert("RGBA")
        ground = Image.new("RGBA", whole.size, (0, 0, 0, 255))
        return Image.alpha_composite(ground, whole).convert("RGB")
    return picture.convert("RGB")


def is_collection(folder: Path) -> bool:
    """Return True if ``folder`` holds labelled pictures as :func:`find_collection` reads."""
    if not folder.is_dir():
        return False
    named = any((folder / name).is_file() for name in (TABLE, ARRAYS))
    halves = all((folder / f"{part}.npz").is_file() for part in PARTS)
    return named or halves or len(_classes(folder)) >= 2 or _is_split(folder)


def find_collection(folder: Path) -> Collection:
    """Find the pictures in ``folder``: arrays, those of a table, or those of folders.

    Raises:
        TrainingError: there are none, or what is said of them cannot be used.
    """
    if (folder / ARRAYS).is_file():
        return _arrays({None: folder / ARRAYS})
    if all((folder / f"{part}.npz").is_file() for part in PARTS):
        return _arrays({part: folder / f"{part}.npz" for part in PARTS})
    if (folder / TABLE).is_file():
        return _table(folder, folder / TABLE)
    if _is_split(folder):
        return _folders(folder, {part: folder / part for part in PARTS})
    if _classes(folder):
        return _folders(folder, {None: folder})
    raise TrainingError(
        f"{folder}: labelled pictures are missing: put PNG or JPEG files into CLASS/, or into "
        f"train/CLASS/ and test/CLASS/, or name them in {TABLE}, or give arrays in {ARRAYS}"
    )


def _is_split(folder: Path) -> bool:
    return all(_classes(folder / part) for part in PARTS)


def _classes(folder: Path) -> list[Path]:
    """Folders in ``folder`` with a picture at any depth, in natural order."""
    if not folder.is_dir():
        return []
    inside = (path for path in folder.iterdir() if path.is_dir() and not _hidden(path))
    return sorted((path for path in inside if next(_below(path), None)), key=lambda path: path.name)


def _below(folder: Path) -> Iterator[Path]:
    """Pictures in ``folder`` and below."""
    for path in folder.rglob("*"):
        visible = not any(part.startswith(".") for part in path.relative_to(folder).parts)
        if visible and path.suffix.lower() in SUFFIXES and path.is_file():
            yield path


def _hidden(path: Path) -> bool:
    return path.name.startswith((".", "__"))


def _folders(folder: Path, roots: dict[Part | None, Path]) -> Files:
    found = [
        (path, Entry(label.name, part=part))
        for part, root in roots.items()
        for label in _classes(root)
        for path in sorted(_below(label))
    ]
    paths, entries = zip(*found, strict=True)
    return Files(folder, paths, entries)


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
        name, label, part = row["file"], row["label"], row.get("part") or None
        require(
            bool(name and label) and None not in row and None not in row.values(),
            f"{table} line {number} has too few or too many values: give one for each column",
        )
        require(
            part in (None, *PARTS), f"{table} line {number}: part is {part!r}: use train or test"
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
        entries.append(Entry(label, row.get("group") or None, part))  # type: ignore[arg-type]
    _check_all_or_none(table, "part", [entry.part for entry in entries])
    _check_all_or_none(table, "group", [entry.group for entry in entries])
    return Files(folder, tuple(paths), tuple(entries))


def _check_all_or_none(table: Path, column: str, values: Sequence[str | None]) -> None:
    given = sum(value is not None for value in values)
    require(
        given in (0, len(values)),
        f"{table} has a {column} for {given} of {len(values)} pictures: give all of them one",
    )


def _arrays(paths: dict[Part | None, Path]) -> Arrays:
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
