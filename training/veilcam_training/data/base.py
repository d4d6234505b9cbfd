"""Images with labels, where they come from, and the part of them that validates."""

import hashlib
import tokenize
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Protocol, Self

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Scene
from veilcam_training.errors import TrainingError, require

SPLIT_SEED = 20220429
"""The validation split is the same for every run, so that no two runs select on different data."""
TEST_SEED = 1
"""Of the test set, where a data set has none of its own."""

UNREADABLE = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    EOFError,
    RuntimeError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
"""What numpy, or the zip file below it, raises where a file is damaged or of another kind."""


@dataclass(frozen=True)
class Images:
    """Images and what they show.

    ``pixels`` is (count, rows, columns) gray or (count, 3, rows, columns) colour: uint8, 255 being
    white, or int32, 65535 being white. ``labels`` is int64 (count,), indices into the source's
    label names. Images of one person, say, have the same number in ``groups``, int64 (count,): they
    are never split apart. ``validation``, bool (count,), is of images that are named to validate.
    """

    pixels: Tensor
    labels: Tensor
    groups: Tensor | None = None
    validation: Tensor | None = None

    def __post_init__(self) -> None:
        require(
            len(self.pixels) == len(self.labels),
            f"{len(self.pixels)} images but {len(self.labels)} labels: use one each",
        )

    def __len__(self) -> int:
        return len(self.labels)

    def take(self, indices: Tensor) -> Self:
        """Return the images at ``indices``, int64 (count,)."""
        groups = None if self.groups is None else self.groups[indices]
        return replace(
            self,
            pixels=self.pixels[indices],
            labels=self.labels[indices],
            groups=groups,
            validation=None if self.validation is None else self.validation[indices],
        )

    def to(self, device: torch.device | str) -> Self:
        """Return the same images on ``device``."""
        return replace(self, pixels=self.pixels.to(device), labels=self.labels.to(device))

    def scenes(self, indices: Tensor | slice = slice(None)) -> Tensor:
        """Images as scenes: float32 in [0, 1], the shape of ``pixels``."""
        return self.pixels[indices].float() / (255 if self.pixels.dtype == torch.uint8 else 65535)


class Source(Protocol):
    """A data set on disk. Its test set is a method of its own, so that fitting never has it."""

    @property
    def name(self) -> str:
        """Name on the command line."""

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of every class."""

    @property
    def colour(self) -> bool:
        """True if its images have three channels."""

    @property
    def scene(self) -> Scene:
        """Size and distance at which its images are shown."""

    def training(self) -> Images:
        """Read the training set."""

    def test(self) -> Images:
        """Read the test set."""

    def digests(self) -> Mapping[str, str]:
        """SHA-256 of every file, by its name."""


def remarks_of(source: Source) -> tuple[str, ...]:
    """Return what a person should know of a data set before a fit; most have no remarks."""
    remarks: tuple[str, ...] = getattr(source, "remarks", ())
    return remarks


class FileSource(ABC):
    """Common part of data sets in files: each reads one of its two parts."""

    def training(self) -> Images:
        """Read the training set.

        Raises:
            TrainingError: a file is missing, damaged, or not in this format.
        """
        return self._read(test=False)

    def test(self) -> Images:
        """Read the test set.

        Raises:
            TrainingError: a file is missing, damaged, or not in this format.
        """
        return self._read(test=True)

    @abstractmethod
    def _read(self, *, test: bool) -> Images:
        """Read the test set, or else the training set."""


@dataclass(frozen=True)
class Split:
    """Training images, and those of them that were set apart to select a model."""

    training: Images
    validation: Images


def split(images: Images, share: float = 0.1) -> Split:
    """Set images apart to validate: those that are named for it, if any are.

    Else it is the last ``share`` of a fixed permutation, of images or of groups.

    Raises:
        TrainingError: a part would be empty.
    """
    if images.validation is not None:
        order = torch.randperm(len(images), generator=torch.Generator().manual_seed(SPLIT_SEED))
        held_out = images.validation[order]
        whole = replace(images, validation=None)
        return Split(whole.take(order[~held_out]), whole.take(order[held_out]))
    groups = torch.arange(len(images)) if images.groups is None else images.groups
    known = torch.unique(groups)
    held = round(share * len(known))
    if not 0 < held < len(known):
        what = "images" if images.groups is None else "groups"
        raise TrainingError(
            f"validation share = {share} leaves {held} of {len(known)} {what} to validate with: "
            "use more of them, or a share that leaves some for both parts"
        )
    order = torch.randperm(len(known), generator=torch.Generator().manual_seed(SPLIT_SEED))
    place = torch.empty_like(known)
    place[order] = torch.arange(len(known))
    # In the order of the permutation, so that the order on disk has no part in the result.
    places = place[torch.searchsorted(known, groups)]
    sequence = places.argsort(stable=True)
    training = int((places < len(known) - held).sum())
    return Split(images.take(sequence[:training]), images.take(sequence[training:]))


def stratified(
    labels: Tensor, share: float, *, where: Path, classes: int, groups: Tensor | None = None
) -> Tensor:
    """Choose the test images: the same ``share`` of each class, or of all groups, by a fixed seed.

    Args:
        labels: int64 (count,), of 0 to ``classes`` - 1.
        share: share in (0, 1).
        where: they come from, for the refusal.
        classes: number of classes.
        groups: int64 (count,) of images that are never split apart; a group may have many classes,
            so its share is of all of them.

    Returns:
        bool (count,).

    Raises:
        TrainingError: a class or the groups are too few for both parts.
    """
    held = torch.zeros(len(labels), dtype=torch.bool)
    generator = torch.Generator().manual_seed(TEST_SEED)
    if groups is not None:
        chosen = _drawn(torch.unique(groups), share, f"{where} has groups", generator)
        return torch.isin(groups, chosen)
    for label in range(classes):
        members = (labels == label).nonzero().flatten()
        held[_drawn(members, share, f"{where} has images of class {label}", generator)] = True
    return held


def _drawn(members: Tensor, share: float, what: str, generator: torch.Generator) -> Tensor:
    count = round(share * len(members))
    require(
        0 < count < len(members),
        f"{what}: {len(members)}, too few for a training and a test set: use more of them",
    )
    return members[torch.randperm(len(members), generator=generator)[:count]]


class ReadOnce:
    """``source``, read from disk once for the many cells that use it."""

    def __init__(self, source: Source) -> None:
        self.name, self.labels = source.name, source.labels
        self.colour, self.scene = source.colour, source.scene
        self.remarks = remarks_of(source)
        self.training, self.test = cache(source.training), cache(source.test)
        self.digests = cache(source.digests)


def find(*places: Path, advice: str = "give the folder that holds it as --data") -> Path:
    """Return the first of ``places`` that is a file.

    Raises:
        TrainingError: none is; it names the first and gives the ``advice``.
    """
    for place in places:
        if place.is_file():
            return place
    raise TrainingError(f"{places[0]} is missing: {advice}")


def digest(*paths: Path) -> str:
    """SHA-256 of the files one after the other, hexadecimal."""
    whole = hashlib.sha256()
    for path in paths:
        whole.update(path.read_bytes())
    return whole.hexdigest()
