"""A data set that is read from disk once, for many fits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Scene
from veilcam_training.errors import TrainingError

SPLIT_SEED = 20220429
"""The validation split is the same for every run, so that no two runs select on different data."""


@dataclass(frozen=True)
class Images:
    """Images and what they show.

    ``pixels`` is uint8, (count, rows, columns) gray or (count, 3, rows, columns) colour, 255 being
    white; ``labels`` is int64 (count,), indices into the source's label names. Images of one
    person, say, have the same number in ``groups``, int64 (count,): they are never split apart.
    """

    pixels: Tensor
    labels: Tensor
    groups: Tensor | None = None

    def __post_init__(self) -> None:
        if len(self.pixels) != len(self.labels):
            raise TrainingError(
                f"{len(self.pixels)} images but {len(self.labels)} labels: use one each"
            )

    def __len__(self) -> int:
        return len(self.labels)

    def take(self, indices: Tensor) -> Images:
        """Return the images at ``indices``, int64 (count,)."""
        groups = None if self.groups is None else self.groups[indices]
        return Images(self.pixels[indices], self.labels[indices], groups)

    def to(self, device: torch.device | str) -> Images:
        """Return the same images on ``device``."""
        return Images(self.pixels.to(device), self.labels.to(device), self.groups)

    def scenes(self, indices: Tensor | slice = slice(None)) -> Tensor:
        """Images as scenes: float32 in [0, 1], the shape of ``pixels``."""
        return self.pixels[indices].float() / 255


class Source(Protocol):
    """A data set on disk. Its test set is a method of its own, so that fitting never has it."""

    @property
    def name(self) -> str:
        """What it is called on the command line."""

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of every class."""

    @property
    def colour(self) -> bool:
        """True if its images have three channels."""

    @property
    def scene(self) -> Scene:
        """How large and how far away its images are shown."""

    def training(self) -> Images:
        """Read the training set."""

    def test(self) -> Images:
        """Read the test set."""

    def digests(self) -> Mapping[str, str]:
        """SHA-256 of every file, by its name."""


@dataclass(frozen=True)
class Split:
    """Training images, and those of them that were set apart to select a model."""

    training: Images
    validation: Images


def split(images: Images, share: float = 0.1) -> Split:
    """Set the last ``share`` of a fixed permutation, of images or of groups, apart to validate.

    Raises:
        TrainingError: a part would be empty.
    """
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


class ReadOnce:
    """A data set that is read from disk once, for the many cells that use it."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._training: Images | None = None
        self._test: Images | None = None
        self._digests: Mapping[str, str] | None = None

    @property
    def name(self) -> str:
        """As the source's."""
        return self._source.name

    @property
    def labels(self) -> tuple[str, ...]:
        """As the source's."""
        return self._source.labels

    @property
    def colour(self) -> bool:
        """As the source's."""
        return self._source.colour

    @property
    def scene(self) -> Scene:
        """As the source's."""
        return self._source.scene

    def training(self) -> Images:
        """As the source's."""
        if self._training is None:
            self._training = self._source.training()
        return self._training

    def test(self) -> Images:
        """As the source's."""
        if self._test is None:
            self._test = self._source.test()
        return self._test

    def digests(self) -> Mapping[str, str]:
        """As the source's."""
        if self._digests is None:
            self._digests = self._source.digests()
        return self._digests
