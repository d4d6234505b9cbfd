"""What a person is told of a data set before it is fitted to."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch

from veilcam_optics.camera.geometry import Scene
from veilcam_training.data import Images, Source
from veilcam_training.data.summary import summarise


@dataclass(frozen=True)
class Given:
    """A data set of what it is given."""

    parts: tuple[Images, Images]
    name: str = "given"
    labels: tuple[str, ...] = ("a", "b")
    scene: Scene = field(default_factory=lambda: Scene(2, 3))
    colour: bool = False

    def training(self) -> Images:
        return self.parts[0]

    def test(self) -> Images:
        return self.parts[1]

    def digests(self) -> dict[str, str]:
        return {}


def images(values: list[int], labels: list[int], groups: list[int] | None = None) -> Images:
    pixels = torch.tensor(values, dtype=torch.uint8)[:, None, None].repeat(1, 2, 3)
    numbers = None if groups is None else torch.tensor(groups)
    return Images(pixels, torch.tensor(labels), numbers)


def test_counts_groups_and_what_is_in_both_parts() -> None:
    source: Source = Given(
        (images([1, 2, 3, 4], [0, 0, 0, 1], [0, 0, 1, 2]), images([4, 9], [1, 0], [3, 3]))
    )
    summary = summarise(source)
    assert (summary.training, summary.test) == ((3, 1), (1, 1))
    assert summary.form == "2 x 3, gray, 3 + 1 groups"
    assert summary.repeated == 1
    assert "1 of 2 test pictures are in the training set too" in summary.warnings[0]
    assert "3 training pictures, the smallest 1" in summary.warnings[1]
    even: Source = Given((images([1, 2], [0, 1]), images([3, 4], [0, 1])))
    assert summarise(even).warnings == ()
