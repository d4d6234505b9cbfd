"""Embeddings and labels, with proof of the mask that they were taken behind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from veilcam_client.wire.base import EXAMPLE_EPOCH, EXAMPLE_TIME, Answer, Question

NPY_MEDIA_TYPE = "application/x-npy"

Form = Literal["flat", "white", "raw"]
"""What an embedding is: ``raw`` as it was read; ``flat`` without the exposure and without what the
mean scene gives behind its mask; ``white`` decorrelated as well, so that masks look alike."""

Release = Literal["none", "flat", "white", "raw"]
"""The form in which a daemon lets embeddings out; ``none``: not at all."""


class ClassificationRequest(Question):
    """What to send back beside the label."""

    include_embedding: bool = False


class Embedding(Answer):
    """The binned sensor measurement, row by row; ``np.asarray`` gives it as float32 of ``shape``.

    Unit of the forms ``raw`` and ``flat``: irradiance relative to what an all-white scene of the
    same size gives at the centre of the sensor without a mask. ``white`` has none.
    """

    form: Form
    shape: tuple[int, ...]
    values: tuple[float, ...] = Field(repr=False)

    @model_validator(mode="after")
    def _check_size(self) -> Embedding:
        if math.prod(self.shape) != len(self.values) or min(self.shape, default=0) < 1:
            raise ValueError(f"{len(self.values)} values do not fill the shape {self.shape}")
        return self

    def __array__(
        self, dtype: npt.DTypeLike | None = None, copy: bool | None = None
    ) -> npt.NDArray[Any]:
        if copy is False:
            raise ValueError("an embedding cannot become an array without a copy")
        values = np.array(self.values, dtype=np.float32).reshape(self.shape)
        return values if dtype is None else values.astype(dtype)

    @classmethod
    def from_array(cls, values: npt.NDArray[np.float32], *, form: Form) -> Embedding:
        """Take the values of an array of any shape."""
        return cls(form=form, shape=tuple(values.shape), values=tuple(values.ravel().tolist()))


class Exposure(Answer):
    """Proof that one mask alone was exposed."""

    started_after_shown_s: float
    """From the end of the write to the panel to the start of the exposure; >= ``settle_s``."""
    settle_s: float
    """What the panel was given to settle."""
    duration_s: float


class Timing(Answer):
    """Where the time of one request went, as the server saw it."""

    queue_s: float
    rotation_s: float
    settle_s: float
    """Spent waiting for the panel to settle."""
    capture_s: float
    """Exposure and readout."""
    inference_s: float | None = None
    total_s: float


class Replay(Answer):
    """Where a capture comes from that was not taken now: from a recording."""

    capture: str
    """Its id when it was taken."""
    place: int
    """In the recording, from 0 on."""
    exposure: Exposure
    """What the recording tells of it. The daemon that replays it has seen no exposure."""


class Capture(Answer):
    """One embedding and the mask epoch that it was taken under."""

    id: str
    taken_at: datetime
    epoch: str
    """Name of one showing of one mask: without the key, it tells nothing but equal or not."""
    scene: int | None = None
    """Which of its scenes a simulated camera looked at, from 0 on; null for a real one."""
    embedding: Embedding
    exposure: Exposure | None
    """None when nothing was exposed, because a recording is replayed."""
    replay: Replay | None = None
    timing: Timing

    def __array__(
        self, dtype: npt.DTypeLike | None = None, copy: bool | None = None
    ) -> npt.NDArray[Any]:
        return self.embedding.__array__(dtype, copy)


class Prediction(Answer):
    """What a classifier makes of one embedding."""

    label: str
    confidence: float
    """Probability of ``label``, in [0, 1]."""
    scores: Mapping[str, float]
    """Probability of every label, in the order of the bundle's labels; they sum to 1."""


class Classification(Answer):
    """The label of what the camera saw."""

    id: str
    taken_at: datetime
    epoch: str
    scene: int | None = None
    """Which of its scenes a simulated camera looked at, from 0 on; null for a real one."""
    label: str
    confidence: float
    """Probability of ``label``, in [0, 1]."""
    scores: Mapping[str, float]
    """Probability of every label; they sum to 1."""
    embedding: Embedding | None = None
    """Only when it was asked for."""
    exposure: Exposure | None
    """None when nothing was exposed, because a recording is replayed."""
    replay: Replay | None = None
    timing: Timing


_EXPOSURE = Exposure(started_after_shown_s=0.104, settle_s=0.1, duration_s=0.01)
_TIMING = Timing(
    queue_s=0.0, rotation_s=0.02, settle_s=0.08, capture_s=0.05, inference_s=0.001, total_s=0.16
)
EXAMPLES = (
    ClassificationRequest(include_embedding=True),
    Capture(
        id="c0ffee00c0ffee00",
        taken_at=EXAMPLE_TIME,
        epoch=EXAMPLE_EPOCH,
        embedding=Embedding(form="white", shape=(2, 3), values=(0.1, -1.2, 0.4, 0.9, -0.3, 0.0)),
        exposure=_EXPOSURE,
        timing=_TIMING,
    ),
    Classification(
        id="c0ffee00c0ffee00",
        taken_at=EXAMPLE_TIME,
        epoch=EXAMPLE_EPOCH,
        label="1",
        confidence=0.98,
        scores={"0": 0.02, "1": 0.98},
        exposure=_EXPOSURE,
        timing=_TIMING,
    ),
)
