"""Digits and bundles for the demonstration; ``README.md`` here says what they are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from veilcam_server.errors import StartError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

DIGITS = Path(__file__).with_name("mnist-sample.npz")
BUNDLE = Path(__file__).with_name("keyring.veilcam")
FRESH = Path(__file__).with_name("fresh.veilcam")


@dataclass(frozen=True, slots=True)
class Digits:
    """Held-out digits: ``images`` uint8 (count, 28, 28), ``labels`` (count,) 0 to 9."""

    images: npt.NDArray[np.uint8]
    labels: npt.NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.labels)


def load_digits(path: Path = DIGITS) -> Digits:
    """Read a sample written by ``python -m veilcam_server.demo_data.make``.

    Raises:
        StartError: the file is missing or not such a sample.
    """
    # Late: whoever asks where the samples are need not wait for NumPy.
    import numpy as np  # noqa: PLC0415

    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            images, labels = archive["images"], archive["labels"]
    except FileNotFoundError:
        raise StartError(
            f"there is no digit file {path}: make it with "
            "'python -m veilcam_server.demo_data.make --mnist DIRECTORY'"
        ) from None
    except Exception:
        raise StartError(
            f"{path} is not a digit file (truncated or damaged): make it again with "
            "'python -m veilcam_server.demo_data.make --mnist DIRECTORY'"
        ) from None
    if (
        images.dtype != np.uint8
        or labels.dtype != np.uint8
        or images.ndim != 3
        or labels.shape != images.shape[:1]
        or not len(labels)
    ):
        raise StartError(f"{path} does not hold uint8 images and labels: make it again")
    return Digits(images, labels)
