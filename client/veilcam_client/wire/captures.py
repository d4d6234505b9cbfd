"""Embeddings and labels, and the epoch of the mask that they were taken behind."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, model_validator

from veilcam_client.errors import SealedError, VeilcamError
from veilcam_client.wire.arrays import ArrayAnswer, Float32List, PicturedArray
from veilcam_client.wire.base import EXAMPLE_EPOCH, EXAMPLE_TIME, Answer, Question
from veilcam_client.wire.sealing import Envelope, example_envelope

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from veilcam_client.numbers import Float32

NPY_MEDIA_TYPE = "application/x-npy"


class ClassificationRequest(Question):
    """Wishes for the answer beside the label."""

    include_embedding: bool = False
    """True: the answer holds the embedding, too."""


class Embedding(PicturedArray):
    """The binned sensor measurement; ``np.asarray`` gives it as float32 of ``shape``.

    Unit: irradiance relative to what an all-white scene of the same size gives at the centre of the
    sensor without a mask.
    """

    form: Literal["raw"]
    """Form in which it left the camera."""
    shape: tuple[int, ...]
    """Rows and columns, or channels before them."""
    values: Float32List = Field(repr=False)
    """Row by row, not to be written to."""

    @model_validator(mode="after")
    def _check_size(self) -> Embedding:
        if math.prod(self.shape) != len(self.values) or min(self.shape, default=0) < 1:
            raise ValueError(f"{len(self.values)} values do not fill the shape {self.shape}")
        return self

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Embedding):
            return NotImplemented
        return self._identity() == other._identity()

    def __hash__(self) -> int:
        return hash(self._identity())

    def _identity(self) -> tuple[tuple[int, ...], bytes]:
        return self.shape, self.values.tobytes()

    def array(self) -> Float32:
        """As :meth:`ArrayAnswer.array`."""
        return self.values.reshape(self.shape)

    @classmethod
    def from_array(cls, values: npt.NDArray[np.float32]) -> Embedding:
        """Take the values of an array of any shape."""
        return cls(form="raw", shape=tuple(values.shape), values=values.ravel())


class SealedEmbedding(ArrayAnswer):
    """An embedding that the camera's receivers alone can open; its size tells nothing.

    ``Camera(key=...)`` opens it. Asked for an array, its length or an index, it raises
    :class:`SealedError`.
    """

    form: Literal["sealed"] = "sealed"
    """Form in which it left the camera."""
    shape: tuple[int, ...]
    """Rows and columns, or channels before them."""
    dtype: Literal["float32"] = "float32"
    """Type of the numbers inside."""
    block: str = Field(repr=False)
    """Ciphertext, base64."""
    envelope: Envelope = Field(repr=False)
    """The key of the epoch, for every receiver."""

    def array(self) -> Float32:
        """As :meth:`ArrayAnswer.array`."""
        raise SealedError(
            "this embedding is sealed: run veilcam pair, or give the private key of a receiver, "
            "Camera(key=...) or --key"
        )

    def __getitem__(self, key: Any) -> Any:
        return self.array()[key]

    def __len__(self) -> int:
        return len(self.array())

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]  # fields are no rows
        return iter(self.array())

    def __bool__(self) -> bool:
        return True  # it is there


AnyEmbedding = Annotated[Embedding | SealedEmbedding, Field(discriminator="form")]


class Exposure(Answer):
    """Times between which one mask alone was exposed."""

    started_after_shown_s: float
    """Time from the end of the write to the panel to the exposure [s]; >= ``settle_s``."""
    settle_s: float
    """Time that the panel was given to settle [s]."""
    duration_s: float
    """Length of the exposure [s]."""


class Timing(Answer):
    """Times of the steps of one capture, as the server saw them."""

    queue_s: float
    """Wait for captures before it [s]."""
    rotation_s: float
    """Change of the mask [s]; 0 where it stayed."""
    settle_s: float
    """Wait for the panel to settle [s]."""
    capture_s: float
    """Exposure and readout [s]."""


class Notes(Answer):
    """Notes that are sealed with an embedding, because they depend on the light or on others."""

    exposure: Exposure
    """Times of the exposure."""
    timing: Timing
    """Times of the steps."""
    scene: int | None = None
    """Number of the scene of a simulated camera, from 0 on; None for a real one."""


class Replay(Answer):
    """Origin of a capture that comes from a recording."""

    capture: str
    """Its id when it was taken."""
    place: int
    """In the recording, from 0 on."""


class Capture(ArrayAnswer):
    """One embedding and the mask epoch that it was taken under."""

    id: str
    """192 random bits, 48 hexadecimal digits: events name it by the first 16, and the rest keeps
    the log from telling what was answered."""
    epoch: str
    """Random name of one showing of one mask: it tells nothing but equal or not."""
    number: int = Field(ge=0)
    """Number of the capture in its epoch, from 0 on."""
    taken_at: datetime
    """To the second."""
    embedding: AnyEmbedding
    """Measurement of the sensor, open or sealed."""
    replay: Replay | None = None
    """Origin in a recording; None for a camera."""
    notes: Notes | None = None
    """Notes of a sealed embedding that was opened; they are never sent in the clear."""

    def array(self) -> Float32:
        """As :meth:`ArrayAnswer.array`."""
        return self.embedding.array()

    @classmethod
    def from_npy(cls, content: bytes, headers: Mapping[str, str]) -> Capture:
        """Read an answer that came as a NumPy file, with its names in its headers.

        Raises:
            ValueError: it is none.
        """
        from veilcam_client.numbers import npy_array  # noqa: PLC0415 - loads NumPy

        values, replay = npy_array(content), headers.get("veilcam-replay")
        embedding = {
            "form": headers.get("veilcam-form"),
            "shape": values.shape,
            "values": values.ravel(),
        }
        # One pass: what an answer in JSON would say, checked as that would be.
        return cls.model_validate(
            {
                "id": headers.get("veilcam-capture"),
                "epoch": headers.get("veilcam-epoch"),
                "number": int(headers.get("veilcam-number", "")),
                "taken_at": datetime.fromisoformat(headers.get("veilcam-taken-at", "")),
                "embedding": embedding,
                "replay": None
                if replay is None
                else {"capture": headers.get("veilcam-replay-capture"), "place": int(replay)},
            }
        )


class Prediction(Answer):
    """Classification of one embedding."""

    label: str
    """Most probable label."""
    confidence: float | None = None
    """Probability of ``label``, in [0, 1]; None where a recording was made without scores."""
    scores: Mapping[str, float] | None = None
    """Probability of every label, in [0, 1], in the order of the bundle's labels; None as above."""


class Classification(ArrayAnswer):
    """The label of what the camera saw."""

    id: str
    """Name of the answer, as of :class:`Capture`."""
    epoch: str
    """Random name of one showing of one mask."""
    number: int = Field(ge=0)
    """Number of the capture in its epoch, from 0 on."""
    taken_at: datetime
    """To the second."""
    label: str
    """Most probable label."""
    confidence: float | None = None
    """Probability of ``label``, in [0, 1]; as of :attr:`scores`."""
    scores: Mapping[str, float] | None = None
    """Probability of every label, in [0, 1]; None without the scope ``read:scores``. In tenths, or
    in full where the daemon was started with ``--full-scores``."""
    embedding: AnyEmbedding | None = None
    """Only when it was asked for."""
    replay: Replay | None = None
    """Origin in a recording; None for a camera."""
    notes: Notes | None = None
    """Notes of a sealed embedding that was opened."""

    def array(self) -> Float32:
        """As :meth:`ArrayAnswer.array`."""
        if self.embedding is None:
            raise VeilcamError(
                "this classification holds no embedding: ask with include_embedding=True",
                code="no_embedding",
            )
        return self.embedding.array()


def examples() -> tuple[Answer | Question, ...]:
    """Return examples for documents."""
    return (
        ClassificationRequest(include_embedding=True),
        Capture(
            id="c0ffee00" * 6,
            epoch=EXAMPLE_EPOCH,
            number=0,
            taken_at=EXAMPLE_TIME,
            embedding=SealedEmbedding(shape=(2, 3), block="c2VhbGVk", envelope=example_envelope()),
        ),
        Classification(
            id="c0ffee00" * 6,
            epoch=EXAMPLE_EPOCH,
            number=0,
            taken_at=EXAMPLE_TIME,
            label="1",
            confidence=0.98,
            scores={"0": 0.02, "1": 0.98},
        ),
    )
