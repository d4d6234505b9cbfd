"""How to fit: every number that the result depends on besides the data and the seed."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from veilcam_training.classifiers import Exposure, Normalisation
from veilcam_training.encoders.panel import PanelErrors
from veilcam_training.jitter import Jitter

Rate = Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)]


class Recipe(BaseModel):
    """One way of fitting. The default values are not tuned to any task."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    epochs: Annotated[int, Field(ge=1, le=10_000)] = 50
    batch: Annotated[int, Field(ge=2, le=65_536)] = 512
    """Images in one step."""
    optimiser: Literal["adam", "sgd"] = "adam"
    rate: Rate = 3e-3
    """Learning rate of the classifier, at its highest."""
    mask_rate: Rate = 3e-2
    """Learning rate of the encoder, at its highest: mask weights have a range of 1."""
    mask_start: Literal["random", "pinhole"] = "random"
    """What a learned mask starts from: random weights, or one open pixel before a dim ground."""
    weight_decay: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Decoupled weight decay of the classifier (AdamW); the encoder has none."""
    schedule: Literal["one_cycle", "steps", "constant"] = "one_cycle"
    """``one_cycle`` warms up and then falls as a cosine; ``steps`` divides by 10."""
    warm_up: Annotated[float, Field(ge=0, lt=1)] = 0.15
    """Share of a ``one_cycle`` schedule in which the rate rises."""
    steps_every: Annotated[int, Field(ge=1)] = 20
    """Epochs between two divisions of a ``steps`` schedule."""
    normalisation: Normalisation = "per_pixel"
    """How a classifier takes a reading, see :data:`veilcam_training.classifiers.Normalisation`."""
    exposure: Exposure = "fixed"
    """Of a reading, see :data:`veilcam_training.classifiers.Exposure`."""
    label_smoothing: Annotated[float, Field(ge=0, lt=1)] = 0.0
    dropout: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Of the classifier's hidden layers."""
    patience: Annotated[int, Field(ge=1)] | None = None
    """Epochs without a better validation accuracy after which fitting stops; None: never."""
    precision: Literal["full", "mixed"] = "full"
    """``mixed`` runs the classifier in bfloat16 where that is safe."""
    jitter: Jitter = Jitter()
    """Random changes of the training images."""
    panel_errors: PanelErrors = PanelErrors()
    """How the panel errs in training."""
    snr_db: Annotated[float, Field(allow_inf_nan=False, ge=-20, le=200)] | None = 40.0
    """Signal-to-noise ratio of a reading [dB]; None for no noise."""

    @model_validator(mode="after")
    def _fit_together(self) -> Self:
        if self.normalisation == "white" and self.precision == "mixed":
            raise ValueError(
                "normalisation 'white' tells apart what bfloat16 rounds away: use precision 'full'"
            )
        return self

    def rate_factor(self, progress: float) -> float:
        """Factor on both learning rates when ``progress``, in [0, 1), of the fit is done."""
        if self.schedule == "constant":
            return 1.0
        if self.schedule == "steps":
            return float(0.1 ** (math.floor(progress * self.epochs + 1e-9) // self.steps_every))
        if progress < self.warm_up:
            return 0.04 + 0.96 * progress / self.warm_up
        falling = (progress - self.warm_up) / (1 - self.warm_up)
        return max(1e-4, 0.5 * (1 + math.cos(math.pi * falling)))
