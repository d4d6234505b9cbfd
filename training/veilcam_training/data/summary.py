"""Summary of a data set, in numbers that a person checks before hours of fitting."""

import hashlib
from dataclasses import dataclass

import torch

from veilcam_training.data.base import Images, Source, remarks_of

UNEVEN = 3
"""Times as many pictures in one class as in another: accuracy then hides the small one's."""


@dataclass(frozen=True)
class Summary:
    """Numbers of a data set."""

    form: str
    """Of its pictures, e.g. ``64 x 64, gray, 120 groups``."""
    training: tuple[int, ...]
    """Pictures of each class to fit with."""
    test: tuple[int, ...]
    repeated: int
    """Test pictures of which the training set has the same, pixel by pixel."""
    remarks: tuple[str, ...] = ()
    """Those of the data set."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """List what a person should know, and what makes an accuracy mean less than it says."""
        found = list(self.remarks)
        if self.repeated:
            found.append(
                f"{self.repeated} of {sum(self.test)} test pictures are in the training set too: "
                "their labels can be learned by heart"
            )
        if max(self.training) >= UNEVEN * min(self.training):
            found.append(
                f"the largest class has {max(self.training)} training pictures, the smallest "
                f"{min(self.training)}: look at each class's accuracy"
            )
        return tuple(found)


def summarise(source: Source) -> Summary:
    """Count what ``source`` holds.

    Raises:
        TrainingError: it cannot be read.
    """
    training, test = source.training(), source.test()
    rows, columns = source.scene.shape
    parts = [f"{rows} x {columns}", "colour" if source.colour else "gray"]
    if training.groups is not None and test.groups is not None:
        groups = [len(torch.unique(images.groups)) for images in (training, test)]
        parts.append(f"{groups[0]} + {groups[1]} groups")
    known = set(_digests(training))
    return Summary(
        ", ".join(parts),
        _counts(training, len(source.labels)),
        _counts(test, len(source.labels)),
        sum(picture in known for picture in _digests(test)),
        remarks_of(source),
    )


def _counts(images: Images, classes: int) -> tuple[int, ...]:
    return tuple(torch.bincount(images.labels, minlength=classes).tolist())


def _digests(images: Images) -> list[bytes]:
    return [hashlib.blake2b(picture.tobytes()).digest() for picture in images.pixels.numpy()]
