"""Scenes that are put before the camera, and what an attacker is asked about each.

Classes are drawn with equal chances whatever a data set's shares are, so that the best constant
guess is known: one in the number of classes.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
import torch
import typer
from torch.nn.functional import interpolate

from veilcam_server.demo_data import load_digits
from veilcam_training.data import open_source
from veilcam_training.data.base import find

Question = Literal["digit", "presence", "kind", "skin", "linkage"]

Scene = npt.NDArray[np.float32]
Pixels = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Stock:
    """Pictures to draw from, uint8 (count, rows, columns), and the class of each."""

    pixels: Pixels
    classes: npt.NDArray[np.int64]

    def draw(self, random: np.random.Generator) -> tuple[Scene, int]:
        """A picture of a class, both drawn uniformly."""
        label = int(random.choice(np.unique(self.classes)))
        chosen = int(random.choice(np.flatnonzero(self.classes == label)))
        return self.pixels[chosen].astype(np.float32) / 255, label


class Scenes:
    """Digits, drawn faces, noise and nothing.

    Args:
        shape: rows and columns of a scene.
        digits: of that shape.
        faces: of that shape, by the tone of their skin; None: without them.
    """

    def __init__(self, shape: tuple[int, int], digits: Stock, faces: Stock | None) -> None:
        self._shape, self._digits, self._faces = shape, digits, faces
        self._kinds = ("digit", "noise") if faces is None else ("digit", "face", "noise")

    @property
    def classes(self) -> dict[Question, int]:
        """Questions that can be asked, and how many answers each has; linkage has same or not."""
        asked: dict[Question, int] = {
            "digit": len(np.unique(self._digits.classes)),
            "presence": 2,
            "kind": len(self._kinds) + 1,
        }
        if self._faces is not None:
            asked["skin"] = len(np.unique(self._faces.classes))
        return asked | {"linkage": 2}

    def draw(self, question: Question, random: np.random.Generator) -> tuple[Scene, int]:
        """A scene, (rows, columns) in [0, 1], and the answer to the question."""
        if question in ("digit", "linkage"):
            return self._digits.draw(random)
        if question == "skin":
            return self._of("face", random)
        kinds = (*self._kinds, "empty")
        if question == "kind":
            label = int(random.integers(len(kinds)))
            return self._of(kinds[label], random)[0], label
        there = int(random.integers(2))
        kind = str(random.choice(self._kinds)) if there else "empty"
        return self._of(kind, random)[0], there

    def _of(self, kind: str, random: np.random.Generator) -> tuple[Scene, int]:
        if kind == "empty":
            return np.zeros(self._shape, np.float32), 0
        if kind == "noise":
            return pink_noise(self._shape, random), 0
        stock = self._digits if kind == "digit" else self._faces
        if stock is None:
            raise typer.BadParameter("there are no faces: give --faces")
        return stock.draw(random)


def pink_noise(shape: tuple[int, int], random: np.random.Generator) -> Scene:
    """Noise whose amplitude falls with 1 / frequency as in natural pictures; from 0 to 1."""
    rows, columns = (np.fft.fftfreq(size)[:, None] for size in shape)
    frequency = np.hypot(rows, columns.T)
    frequency[0, 0] = np.inf
    phase = random.uniform(0, 2 * np.pi, shape)
    picture = np.fft.ifft2(np.exp(1j * phase) / frequency).real
    low, high = float(np.min(picture)), float(np.max(picture))
    return ((picture - low) / (high - low)).astype(np.float32)


def load_scenes(shape: tuple[int, int], data: Path | None, faces: Path | None) -> Scenes:
    """Read what is asked for.

    Args:
        shape: rows and columns of a scene.
        data: folder of MNIST's files; None: the digits that come with the daemon.
        faces: folder that holds ``faces.npz``; None: without them.
    """
    if data is None:
        shipped = load_digits()
        digits = Stock(shipped.images, shipped.labels.astype(np.int64))
    else:
        images = open_source("mnist", data).training()
        digits = Stock(images.pixels.numpy(), images.labels.numpy())
    if digits.pixels.shape[1:] != shape:
        raise typer.BadParameter(f"digits are {digits.pixels.shape[1:]}, scenes {shape}")
    return Scenes(shape, digits, None if faces is None else load_faces(faces, shape))


def load_faces(folder: Path, shape: tuple[int, int]) -> Stock:
    """Drawn faces by skin: their middle square, as many pixels as a scene has."""
    path = find(folder / "faces.npz", advice="give the folder that holds it as --faces")
    try:
        with np.load(path, allow_pickle=False) as content:
            pixels, skin = content["images"], content["skin"]
    except (KeyError, ValueError, zipfile.BadZipFile):
        raise typer.BadParameter(f"{path} holds no images, or not their skin") from None
    rows, columns = pixels.shape[1:]
    side = min(rows, columns)
    top, left = (rows - side) // 2, (columns - side) // 2
    square = torch.from_numpy(pixels[:, top : top + side, left : left + side])
    small = interpolate(square[:, None].float(), size=shape, mode="area")[:, 0]
    return Stock(small.round().byte().numpy(), skin.astype(np.int64))
