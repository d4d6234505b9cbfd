"""Drawn faces in one ``faces.npz``: portraits made by a program, with known attributes.

They are easier than photographs: their numbers do not stand beside those of photographs as equals.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from veilcam_optics.camera.geometry import Scene
from veilcam_training.data.base import UNREADABLE, FileSource, Images, digest, find, stratified
from veilcam_training.errors import TrainingError, require

ATTRIBUTES: Mapping[str, tuple[str, str, str]] = {
    "faces-gender": ("female", "male", "female"),
    "faces-smiling": ("smiling", "not smiling", "smiling"),
    "faces-glasses": ("glasses", "no glasses", "glasses"),
}
"""Task: the array that holds it, and what its 0 and 1 are called."""
TEST_SHARE = 0.15


@dataclass(frozen=True)
class FacesSource(FileSource):
    """One attribute of the drawn faces.

    The file holds ``images`` uint8 (count, rows, columns), ``identity`` (count,), and one array of
    0 and 1 for each attribute. An identity is either in the training set or in the test set.
    """

    name: str
    folder: Path
    scene: Scene = field(default_factory=lambda: Scene(64, 52, 0.27, 0.55))
    colour: bool = False

    @property
    def labels(self) -> tuple[str, str]:
        """Name of either class."""
        return ATTRIBUTES[self.name][1:]

    @property
    def path(self) -> Path:
        """The file; raises TrainingError if it is missing."""
        return find(self.folder / "faces.npz")

    def digests(self) -> Mapping[str, str]:
        """SHA-256 of the file."""
        return {self.path.name: digest(self.path)}

    def _read(self, *, test: bool) -> Images:
        """Read one part; ``groups`` are the identities."""
        path, array = self.path, ATTRIBUTES[self.name][0]
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
                pixels, labels = content["images"], content[array]
                identities = content["identity"]
        except UNREADABLE:
            raise TrainingError(
                f"{path} is damaged, or lacks images, {array} or identity: get it again"
            ) from None
        require(
            pixels.dtype == np.uint8 and pixels.shape[1:] == self.scene.shape and pixels.size != 0,
            f"{path} has images {pixels.dtype} {pixels.shape}: "
            f"use uint8 (count, {self.scene.rows}, {self.scene.columns})",
        )
        for name, values in ((array, labels), ("identity", identities)):
            require(
                values.dtype.kind in "biu" and values.shape == pixels.shape[:1],
                f"{path} has {name} {values.dtype} {values.shape}: "
                f"use a whole number for each of the {len(pixels)} images",
            )
        require(
            bool(np.isin(labels, (0, 1)).all()),
            f"{path} has {array} other than 0 and 1: get it again",
        )
        groups = torch.from_numpy(identities.astype(np.int64))
        images = Images(torch.from_numpy(pixels), torch.from_numpy(labels.astype(np.int64)), groups)
        held = stratified(images.labels, TEST_SHARE, where=path, classes=2, groups=groups)
        return images.take((held == test).nonzero().flatten())
