"""The wire contract of the REST API, version 1. Times in seconds, wall-clock times in UTC.

The server answers with these models and the SDK reads them. What is asked is closed (a field that
is not known is refused); what is answered is open (a field that a newer server adds is ignored).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, model_validator

API_VERSION = 1
NPY_MEDIA_TYPE = "application/x-npy"
PROBLEM_MEDIA_TYPE = "application/problem+json"

State = Literal[
    "starting", "self-test", "ready", "calibrating", "degraded", "safe", "replay", "stopping"
]
"""``safe``: the panel is opaque (or its content unknown) and no capture is taken; ``replay``: there
is no panel, and captures come from a recording."""

Form = Literal["flat", "white", "raw"]
"""What an embedding is: ``raw`` as it was read; ``flat`` without the exposure and without what the
mean scene gives behind its mask; ``white`` decorrelated as well, so that masks look alike."""
Release = Literal["none", "flat", "white", "raw"]
"""The form in which a daemon lets embeddings out; ``none``: not at all."""


class Answer(BaseModel):
    """What a daemon answers: checked strictly, and open to what a newer one adds."""

    model_config = ConfigDict(strict=True, frozen=True, extra="ignore", allow_inf_nan=False)


class Question(BaseModel):
    """What a client asks: checked strictly, and closed to what is not known."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False)


class RotationOff(Question):
    """The mask stays until it is changed by hand."""

    mode: Literal["off"] = "off"


class EverySeconds(Question):
    """A new mask once the present one has been shown for ``seconds`` [s], or a little less."""

    mode: Literal["seconds"] = "seconds"
    seconds: float = Field(ge=0.1, le=86_400.0)
    jitter: float = Field(default=0.0, ge=0.0, le=86_400.0)
    """Each mask stays shorter by a random time of up to this [s], drawn anew for each."""
    reuse: int = Field(default=0, ge=0, le=1_000_000)
    """Captures that a mask may still serve when it is due and the next is not ready; 0 waits."""

    @model_validator(mode="after")
    def _check_jitter(self) -> EverySeconds:
        if self.seconds - self.jitter < 0.1:
            raise ValueError(
                f"jitter {self.jitter:g} s leaves a mask less than 0.1 s of {self.seconds:g} s"
            )
        return self


class EveryCaptures(Question):
    """A new mask once the present one has served ``captures`` captures."""

    mode: Literal["captures"] = "captures"
    captures: int = Field(ge=1, le=1_000_000)
    reuse: int = Field(default=0, ge=0, le=1_000_000)
    """Captures more that a mask may serve when the next one is not ready; 0 waits for it."""


RotationPolicy = Annotated[RotationOff | EverySeconds | EveryCaptures, Field(discriminator="mode")]


class ClassificationRequest(Question):
    """What to send back beside the label."""

    include_embedding: bool = False


class Embedding(Answer):
    """The binned sensor reading, row by row; ``np.asarray`` gives it as float32 of ``shape``.

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


class Preparation(Answer):
    """Of the epoch that comes next: done in the background, so that no capture waits for it."""

    ready: bool
    prepared: int
    """Epochs prepared so far."""
    last_s: float
    """How long the last one took; 0 before the first."""
    late: int
    """How many masks a capture found due before the next one was ready."""
    reused: int
    """Captures taken under a mask that was due, because the policy allows it."""


class Rotation(Answer):
    """How masks change, and which one is shown."""

    policy: RotationPolicy
    epoch: str | None
    """None while no mask is shown."""
    captures: int
    """Taken under this epoch so far."""
    preparation: Preparation


class Device(Answer):
    """The panel and the sensor."""

    display: str
    sensor: str
    simulated: bool


class BundleInfo(Answer):
    """What training handed over, without its secrets."""

    digest: str
    """SHA-256 of the file."""
    task: str
    mode: str
    """``pairs``: stored masks; ``fresh``: a new one for every epoch, drawn from a key."""
    labels: tuple[str, ...]
    embedding_shape: tuple[int, ...]
    pairs: int
    """Stored masks; 0 in mode ``fresh``."""


class Queue(Answer):
    """Captures admitted and not yet answered, and how many may be."""

    waiting: int
    limit: int


class Status(Answer):
    """The daemon at a glance."""

    version: str
    api_version: int
    state: State
    detail: str | None = None
    """Why the state is not ``ready``."""
    experiment: str | None = None
    """``wrong-classifier`` when labels are meaningless on purpose."""
    uptime_s: float
    captures: int
    release: Release
    """In which form embeddings leave."""
    device: Device
    bundle: BundleInfo
    rotation: Rotation
    queue: Queue


class FieldError(Answer):
    """One field that was refused."""

    location: str
    message: str


class Problem(Answer):
    """Problem details (RFC 9457) with a stable ``code``."""

    type: str
    title: str
    status: int
    detail: str
    instance: str
    code: str
    request_id: str
    retryable: bool
    errors: tuple[FieldError, ...] = ()


POLICY: TypeAdapter[RotationPolicy] = TypeAdapter(RotationPolicy)
