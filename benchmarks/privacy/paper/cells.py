"""Cells of a table: computed once and kept, with what is known of their means."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from statistics import NormalDist, fmean, stdev
from typing import Annotated, Any, TypeAlias

import torch
import typer
from torch import Tensor

from veilcam_optics.files import write_whole
from veilcam_training.attacks.metrics import psnr, ssim
from veilcam_training.data import Images, Source
from veilcam_training.seeding import stream

EXAMPLES = 4
"""Pictures of a cell that are kept, to be looked at."""
CONFIDENCE = 0.99

DataOption: TypeAlias = Annotated[Path, typer.Option(help="Folder with the data set's files.")]
SourceOption: TypeAlias = Annotated[str, typer.Option(help="Data set, as veilcam-train names it.")]
WorkOption: TypeAlias = Annotated[Path, typer.Option(help="Folder of finished cells: resumed.")]
PicturesOption: TypeAlias = Annotated[
    Path | None, typer.Option(help="Folder for pictures of what the attacker sees.")
]

Values = dict[str, Any]


class Cells:
    """Finished cells in a folder.

    Args:
        folder: made if it is not there.
        said: what they depend on; cells of anything else are refused.
    """

    def __init__(self, folder: Path, said: Mapping[str, object]) -> None:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self.folder, shape, text = folder, folder / "settings.json", json.dumps(said)
        if shape.exists() and json.loads(shape.read_text()) != json.loads(text):
            raise typer.BadParameter(f"{shape} says that other cells were computed here")
        write_whole(shape, text.encode())

    def get(self, name: str, make: Callable[[], Values]) -> Values:
        """The values of cell ``name``, made if they are not there."""
        path = self.folder / f"{name}.json"
        if not path.exists():
            write_whole(path, json.dumps(make()).encode(), private=True)
        found: Values = json.loads(path.read_text())
        return found


@dataclass(frozen=True)
class Mean:
    """A mean over pictures, and half of its interval."""

    value: float
    half: float

    def __str__(self) -> str:
        return f"{self.value:.2f} ± {self.half:.2f}"

    @property
    def least(self) -> float:
        """Lower end of the interval."""
        return self.value - self.half


def mean(values: Sequence[float]) -> Mean:
    """Of independent pictures; the two-sided normal interval of ``CONFIDENCE``."""
    width = NormalDist().inv_cdf((1 + CONFIDENCE) / 2)
    return Mean(fmean(values), width * stdev(values) / math.sqrt(len(values)))


def difference(more: Sequence[float], less: Sequence[float]) -> Mean:
    """Of the same pictures, one by one."""
    return mean([one - other for one, other in zip(more, less, strict=True)])


def proven(gain: Mean) -> str:
    """A difference in dB, and whether it is one."""
    verdict = "win" if gain.value > gain.half else "loss" if gain.value < -gain.half else "tie"
    return f"{gain} dB: {verdict}"


def likeness(estimates: Tensor, truth: Tensor) -> Values:
    """PSNR [dB] and SSIM of every picture, data range 1, and the first pictures themselves."""
    shown = (255 * estimates[:EXAMPLES]).round().int()
    return {
        "psnr": psnr(estimates, truth).tolist(),
        "ssim": ssim(estimates, truth).tolist(),
        "pictures": shown.tolist(),
    }


def published() -> dict[str, float]:
    """The paper's cells by the names of figures."""
    text = (files("benchmarks.paper") / "paper.json").read_text()
    attacks: dict[str, float] = json.loads(text)["attacks"]
    return attacks


def gray(images: Images, chosen: Tensor) -> Tensor:
    """Scenes (count, rows, columns); colours are averaged."""
    scenes = images.scenes(chosen)
    return scenes.mean(1) if scenes.ndim == 4 else scenes


def one_of_each(images: Images, count: int, *purpose: str) -> Tensor:
    """Places of ``count`` pictures, where pictures have groups of as many groups as there are."""
    order = torch.randperm(len(images), generator=stream(1, *purpose))
    if images.groups is not None:
        seen: set[int] = set()
        first: list[int] = []
        more: list[int] = []
        for place in order.tolist():
            group = int(images.groups[place])
            (more if group in seen else first).append(place)
            seen.add(group)
        order = torch.tensor(first + more)
    if len(order) < count:
        raise typer.BadParameter(f"{len(order)} pictures are fewer than {count}: use more data")
    return order[:count]


def mean_picture(source: Source) -> Tensor:
    """Of the training set: the best guess without any capture, (rows, columns)."""
    images = source.training()
    return gray(images, torch.arange(0, len(images), max(1, len(images) // 2000))).mean(0)


def row(name: str, found: Mean, paper: float | None, said: str) -> None:
    """Print one cell beside the paper's."""
    beside = "     -" if paper is None else f"{paper:6.2f}"
    print(f"{name:34}{found!s:>16}   paper {beside}   {said}", flush=True)
