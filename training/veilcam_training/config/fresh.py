"""All that a classifier for fresh masks depends on, besides the files of its data set."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import torch
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from veilcam_training.config.settings import refusal
from veilcam_training.data import Source
from veilcam_training.errors import TrainingError
from veilcam_training.transforms.augmentation import ShearedAugmentation

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1, le=2**20)]


class Misalignment(BaseModel):
    """What calibration leaves unknown: the decoder assumes the nominal geometry.

    Each mask is shown by a panel that is displaced by normal random amounts with these standard
    deviations.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    shift: NotNegative = 2e-6
    """Along y and along x [m]."""
    distance: NotNegative = 5e-6
    """Between mask and sensor [m]."""
    panels: Annotated[int, Field(ge=1, le=1024)] = 16
    """How many displaced panels are made; each mask takes one at random."""


class FreshSettings(BaseModel):
    """How to fit one classifier to a stream of masks that are used for a moment and never again."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    data: str = "mnist"
    embedding: str = "24x32"
    placement: Literal["centred", "anywhere"] = "centred"
    """``anywhere``: the object lies anywhere fully in the field of view."""
    exponent: Positive = 1.0
    """Masks are ``u ** exponent`` for uniform ``u``, rounded to the panel's levels."""
    spread: Annotated[float, Field(gt=0, le=1)] | None = None
    """Learn a range of ``u`` for each sub-pixel, this much to both sides of a centre."""
    mask_rate: Positive = 5e-2
    """Highest learning rate of the centres; they have a range of 1."""
    rank: Count = 384
    """Principal components of the scene that the decoder uses."""
    pooling: Annotated[int, Field(ge=1, le=16)] = 1
    """Side, in scene pixels, of a pixel of the decoded scene."""
    snr_db: Annotated[float, Field(allow_inf_nan=False, ge=-20, le=200)] = 40.0
    misalignment: Misalignment | None = Misalignment()
    model_error: NotNegative = 0.0
    """Relative error of the response that the decoder expects."""
    classifier: str = "CNN32"
    augmentation: ShearedAugmentation | None = ShearedAugmentation()
    epochs: Annotated[int, Field(ge=1, le=10_000)] = 20
    batch: Count = 128
    """Images in one step, spread evenly over the masks in use."""
    masks: Count = 4
    """Masks in use at a time."""
    renewed: Count = 1
    """How many of them are replaced before every step."""
    rate: Positive = 3e-3
    """Highest learning rate (AdamW)."""
    weight_decay: NotNegative = 1e-2
    label_smoothing: Annotated[float, Field(ge=0, lt=1)] = 0.05
    averaging: Annotated[float, Field(ge=0, lt=1)] = 0.998
    """Decay per step of the running mean of the weights; the mean is what is used."""
    bfloat16: bool = True
    """Fit in mixed precision; the result is float32 all the same."""
    validation_masks: Count = 200
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0

    def fingerprint(self, source: Source) -> str:
        """SHA-256 of the settings and of the data: two fits are the same if these are."""
        files = sorted(source.digests().items())
        # Without defaults: a setting that is added later does not disown what was fitted before.
        chosen = self.model_dump_json(exclude_defaults=True)
        text = f"{chosen} {files} torch {torch.__version__}"
        return hashlib.sha256(text.encode()).hexdigest()


def find_settings(name: str, **changes: Any) -> FreshSettings:
    """The settings of task ``name``, with single ones changed.

    Raises:
        TrainingError: an unknown name, or a change that no setting has or allows.
    """
    if name not in TASKS:
        raise TrainingError(f"task {name!r} is unknown: use one of {', '.join(TASKS)}")
    try:
        return FreshSettings(**{**TASKS[name], **changes})
    except ValidationError as error:
        raise refusal(f"task {name}", error) from None


TASKS: Mapping[str, Mapping[str, Any]] = {
    "mnist_24x32": {},
    "mnist_12x16": {
        "embedding": "12x16",
        "masks": 16,
        "renewed": 4,
        "exponent": 4.0,
        "epochs": 14,
    },
    "mnist_6x8": {
        "embedding": "6x8",
        "masks": 8,
        "renewed": 8,
        "exponent": 4.0,
        "spread": 0.25,
        "epochs": 12,
    },
    "mnist_3x4": {
        "embedding": "3x4",
        "masks": 8,
        "renewed": 8,
        "exponent": 4.0,
        "spread": 0.25,
        "epochs": 8,
    },
    "mnist_shift": {
        "placement": "anywhere",
        "pooling": 2,
        "rank": 512,
        "classifier": "CNN16",
        "batch": 256,
        "epochs": 6,
        "misalignment": Misalignment(panels=4),
    },
    "fashion_24x32": {
        "data": "fashion",
        "exponent": 4.0,
        "epochs": 16,
        "augmentation": ShearedAugmentation(
            rotation=3, scale=0.05, shear=0.03, shift=1.0, mirror=True
        ),
    },
    "faces_gender_24x32": {
        "data": "faces-gender",
        "pooling": 2,
        "augmentation": ShearedAugmentation(
            rotation=5, scale=0.08, shear=0.05, shift=2.0, mirror=True
        ),
    },
}
