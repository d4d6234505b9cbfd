"""Somebody's own pictures as a data set: a folder, and perhaps a ``dataset.toml`` in it."""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

import torch
from pydantic import BaseModel, Field, ValidationError

from veilcam_optics.camera.geometry import Scene
from veilcam_training.data.base import FileSource, Images, digest, stratified
from veilcam_training.data.collection import Collection, find_collection
from veilcam_training.data.folders import DESCRIPTION, shown
from veilcam_training.errors import TrainingError, require
from veilcam_training.labels import labels_fault

NAME = "image-folder"
LONGER_SIDE = 32
"""Of a scene whose pictures are larger [pixels]: as many as an embedding has columns."""

Length = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
Side = Annotated[int, Field(ge=1, le=512)]


class Description(BaseModel, frozen=True, extra="forbid", strict=True):
    """Contents of ``dataset.toml``; what it leaves out follows from the pictures."""

    rows: Side | None = None
    """Of the scene, with ``columns``: the median picture's, reduced to 32 on its longer side."""
    columns: Side | None = None
    height: Length = 0.27
    """How tall a picture stands before the camera [m]."""
    distance: Length = 0.55
    """How far away [m]."""
    colour: bool | None = None
    """Three channels; by default, if a picture has colour."""
    test_share: Annotated[float, Field(gt=0, lt=1)] = 0.15
    """Of each class, or of the groups, that tests where nothing names the test set."""
    group: str | None = None
    """Regular expression with one group, searched for in a file's path below the folder: pictures
    for which it finds the same, a person's name, say, are never in two parts."""


@dataclass(frozen=True)
class ImageFolderSource(FileSource):
    """Labelled pictures in any of the forms of :func:`find_collection`."""

    folder: Path
    name: str = NAME
    skip_damaged: bool = False
    """Whether pictures that cannot be read are left out."""

    @cached_property
    def _said(self) -> Description:
        path = self.folder / DESCRIPTION
        if not path.exists():
            return Description()
        try:
            said = Description.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
            require(
                (said.rows is None) == (said.columns is None),
                f"{path} has one of rows and columns: give both or neither",
            )
            require(
                said.group is None or re.compile(said.group).groups == 1,
                f"{path}: group has not one group in parentheses: use e.g. '(person[0-9]+)_'",
            )
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, re.error) as error:
            raise TrainingError(f"{path} cannot be used ({error}): mend it") from None
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False)[0]
            place = ".".join(str(step) for step in first["loc"])
            raise TrainingError(f"{path}: {place} is not valid: {first['msg']}") from None
        return said

    @cached_property
    def _collection(self) -> Collection:
        return find_collection(self.folder, skip_damaged=self.skip_damaged)

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Name of every class, numbers by their value.

        Raises:
            TrainingError: fewer than two, or a name that is no label.
        """
        names = {entry.label for entry in self._collection.entries}
        require(
            len(names) >= 2,
            f"{shown(self.folder)} has one class, {', '.join(map(shown, names))}: "
            "give pictures of two or more",
        )
        if (fault := labels_fault(sorted(names))) is not None:
            raise TrainingError(f"{shown(self.folder)}: {fault}")
        numbers = all(name.isdecimal() for name in names)
        return tuple(sorted(names, key=(lambda name: (int(name), name)) if numbers else None))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks: what was passed over, and pictures that use little of their range."""
        return self._collection.remarks

    @property
    def colour(self) -> bool:
        """True if one of its pictures has colour, unless the description says otherwise."""
        said = self._said.colour
        return self._collection.colour if said is None else said

    @cached_property
    def scene(self) -> Scene:
        """As large and as far away as the description says."""
        said, (rows, columns) = self._said, self._collection.size
        if said.rows is not None and said.columns is not None:
            rows, columns = said.rows, said.columns
        elif (longer := max(rows, columns)) > LONGER_SIDE:
            rows = max(1, round(rows * LONGER_SIDE / longer))
            columns = max(1, round(columns * LONGER_SIDE / longer))
        return Scene(rows, columns, said.height, said.distance)

    def digests(self) -> Mapping[str, str]:
        """SHA-256 of all pictures with what is said of each, and of the description."""
        description = self.folder / DESCRIPTION
        said = {DESCRIPTION: digest(description)} if description.is_file() else {}
        return {"pictures": self._collection.digest(), **said}

    def _groups(self) -> list[str] | None:
        """Group of every picture; None if there are none."""
        collection, pattern = self._collection, self._said.group
        if pattern is None:
            groups = [entry.group for entry in collection.entries]
            return None if None in groups else [str(group) for group in groups]
        if collection.names is None:
            raise TrainingError(
                f"{self.folder / DESCRIPTION} has a group, but there are no file names: "
                "put an array groups beside images and labels"
            )
        found = []
        for name in collection.names:
            match = re.search(pattern, name)
            if match is None or match[1] is None:
                raise TrainingError(
                    f"{self.folder / DESCRIPTION}: group {pattern!r} does not occur in {name}: "
                    "change either"
                )
            found.append(match[1])
        return found

    @cached_property
    def _groups_and_test(self) -> tuple[torch.Tensor | None, torch.Tensor]:
        """Number of each picture's group, int64 (count,), or None; and which pictures test."""
        entries, names = self._collection.entries, self._groups()
        groups = None
        if names is not None:
            numbers = {name: number for number, name in enumerate(sorted(set(names)))}
            groups = torch.tensor([numbers[name] for name in names])
        labels = self._numbers()
        if all(entry.part is not None for entry in entries):
            test = torch.tensor([entry.part == "test" for entry in entries])
        else:
            test = stratified(
                labels,
                self._said.test_share,
                where=self.folder,
                classes=len(self.labels),
                groups=groups,
            )
        for chosen, part in ((~test, "training"), (test, "test")):
            absent = set(range(len(self.labels))) - set(labels[chosen].tolist())
            require(
                not absent,
                f"{self.folder}: {', '.join(self.labels[label] for label in sorted(absent))} "
                f"is in no {part} picture: add pictures, or name the parts yourself",
            )
        if groups is not None:
            both = set(groups[test].tolist()) & set(groups[~test].tolist())
            require(
                not both,
                f"{self.folder}: {len(both)} groups are in the training and in the test set: "
                "put each into one of them",
            )
        return groups, test

    def _numbers(self) -> torch.Tensor:
        """Index of every picture's label."""
        index = {name: number for number, name in enumerate(self.labels)}
        return torch.tensor([index[entry.label] for entry in self._collection.entries])

    def _read(self, *, test: bool) -> Images:
        """Read one part."""
        collection = self._collection
        groups, held = self._groups_and_test
        chosen = (held == test).nonzero().flatten()
        pixels = collection.pixels(chosen.tolist(), self.scene.shape, colour=self.colour)
        labels = self._numbers()[chosen]
        parts = [self._collection.entries[index].part for index in chosen.tolist()]
        validation = torch.tensor([part == "validation" for part in parts])
        return Images(
            torch.from_numpy(pixels),
            labels,
            None if groups is None else groups[chosen],
            validation if "validation" in parts else None,
        )
