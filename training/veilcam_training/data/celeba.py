"""CelebA: aligned photographs and ``list_attr_celeba.txt`` (Liu et al. 2015), as in the paper.

The paper takes the first 100,000 images, gray, and splits them 85 to 15. The split is stratified:
both parts have the same share of either class.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from PIL import Image

from veilcam_optics.camera.geometry import Scene
from veilcam_optics.pictures import PictureError, read_picture
from veilcam_training.data.base import FileSource, Images, digest, find, stratified
from veilcam_training.errors import TrainingError, require

ATTRIBUTES: Mapping[str, tuple[str, str, str]] = {
    "celeba-gender": ("Male", "female", "male"),
    "celeba-smiling": ("Smiling", "not smiling", "smiling"),
}
"""Task: the column that holds it, and what its -1 and 1 are called."""
FIRST = 100_000
TEST_SHARE = 0.15
SHAPE = (218, 178)
"""Rows and columns of an aligned photograph."""
ATTRIBUTE_FILE = "list_attr_celeba.txt"
IMAGE_FOLDER = "img_align_celeba"


@dataclass(frozen=True)
class CelebaSource(FileSource):
    """One attribute of the first ``first`` photographs.

    An embedding pixel of 24 x 32 is 21 rows of the original at the sensor, so the photographs are
    reduced to the scene's rows and columns (area averages) when they are read.
    """

    name: str
    folder: Path
    first: int = FIRST
    scene: Scene = field(default_factory=lambda: Scene(64, 52, 0.27, 0.55))
    colour: bool = False

    @property
    def labels(self) -> tuple[str, str]:
        """Name of either class."""
        return ATTRIBUTES[self.name][1:]

    def digests(self) -> Mapping[str, str]:
        """SHA-256 of the attributes, and of all photographs one after the other."""
        return {
            ATTRIBUTE_FILE: digest(self._table()),
            IMAGE_FOLDER: digest(*map(self._photograph, self._attributes())),
        }

    def _table(self) -> Path:
        return find(self.folder / ATTRIBUTE_FILE, self.folder / "Anno" / ATTRIBUTE_FILE)

    def _photograph(self, name: str) -> Path:
        places = (self.folder / IMAGE_FOLDER / name, self.folder / "Img" / IMAGE_FOLDER / name)
        return find(*places, advice=f"unpack {IMAGE_FOLDER}.zip there")

    def _attributes(self) -> dict[str, int]:
        """Class of each of the first photographs, by its file name."""
        path, column = self._table(), ATTRIBUTES[self.name][0]
        lines = path.read_text(encoding="ascii", errors="replace").splitlines()
        # The first line counts the photographs, the second names the columns.
        require(
            len(lines) >= 3 and column in lines[1].split(),
            f"{path} has no column {column}: fetch it again",
        )
        require(
            lines[0].split() == [str(len(lines) - 2)],
            f"{path} has {len(lines) - 2} photographs, not as many as its first line says: "
            "fetch it again",
        )
        columns = lines[1].split()
        index = columns.index(column) + 1
        result: dict[str, int] = {}
        for number, line in enumerate(lines[2 : 2 + self.first], start=3):
            words = line.split()
            require(
                len(words) == len(columns) + 1 and words[index] in ("1", "-1"),
                f"{path} line {number} is not valid: fetch it again",
            )
            require(
                words[0] not in result, f"{path} line {number} repeats {words[0]}: fetch it again"
            )
            result[words[0]] = int(words[index] == "1")
        return result

    def _read(self, *, test: bool) -> Images:
        attributes = self._attributes()
        labels = torch.tensor(list(attributes.values()))
        chosen = stratified(labels, TEST_SHARE, where=self.folder, classes=2) == test
        names = [name for name, take in zip(attributes, chosen.tolist(), strict=True) if take]
        pixels = np.stack([self._pixels(self._photograph(name)) for name in names])
        return Images(torch.from_numpy(pixels), labels[chosen])

    def _pixels(self, path: Path) -> npt.NDArray[np.uint8]:
        try:
            photograph = read_picture(path)
        except PictureError as error:
            raise TrainingError(f"{path} is damaged (it {error}): fetch it again") from None
        require(
            photograph.shape[:2] == SHAPE and photograph.dtype == np.uint8,
            f"{path} has {photograph.shape[0]} x {photograph.shape[1]} pixels: "
            f"use the aligned photographs of {SHAPE[0]} x {SHAPE[1]}",
        )
        rows, columns = self.scene.shape
        gray = Image.fromarray(photograph).convert("L")
        return np.asarray(gray.resize((columns, rows), Image.Resampling.BOX))
