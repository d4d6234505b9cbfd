"""The wire contract of the capture log: signed records, each of which names the one before."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, ConfigDict, Field

from veilcam_client.wire.base import (
    EXAMPLE_DIGEST,
    EXAMPLE_EPOCH,
    EXAMPLE_TIME,
    Answer,
    Examples,
    Result,
)
from veilcam_client.wire.sealing import EXAMPLE_DEVICE

LOG_VERSION: Literal[1] = 1
RECORDS_AT_ONCE = 1000
"""In one answer at most: some 700 kB."""
AGE_STEP = 60
"""The age of a self-test is told in steps of so much [s]: when light ended one early is not."""
_NAME, _DIGEST, _SIGNATURE = (rf"^[0-9a-f]{{{digits}}}$" for digits in (32, 64, 128))
_Position = Annotated[int, Field(ge=0, lt=2**63)]


def _whole_second(at: datetime) -> datetime:
    if at.utcoffset() != timedelta(0) or at.microsecond:
        raise ValueError("is not valid: use a whole second of UTC")
    return at


Second = Annotated[datetime, AfterValidator(_whole_second)]


class _Signed(Result):
    """Base of signed models: closed, so that nothing unknown stands beside what is signed."""

    model_config: ClassVar[ConfigDict] = ConfigDict(
        strict=True, frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True
    )


class LoggedCapture(_Signed):
    """An answer that left: a capture, or its label."""

    kind: Literal["capture"] = "capture"
    """Kind of the entry."""
    epoch: str = Field(pattern=_NAME)
    """Random name of one showing of one mask."""
    number: int = Field(ge=0)
    """Number of the capture in its epoch."""
    taken_at: Second
    """Time of the capture, to the second."""
    mask: str = Field(pattern=_DIGEST)
    """Hiding commitment to the mask: HMAC-SHA256 of its levels under a key of the epoch."""
    tested_s: int = Field(ge=0, multiple_of=AGE_STEP)
    """At most so long before, the panel passed its self-test [s]."""
    calibration: str | None = Field(pattern=_DIGEST)
    """SHA-256 of the calibration in force; None: the camera was taken to be nominal."""
    answer: str = Field(pattern=_DIGEST)
    """SHA-256 of the answer, hidden by the answer's id."""


class LogStarted(_Signed):
    """The daemon began to write."""

    kind: Literal["start"] = "start"
    """Kind of the entry."""
    at: Second
    """Time of the start, to the second."""
    after: Literal["nothing", "stop", "cut", "damage", "loss"]
    """Reason of the start: no log; a stop; an end without one, so that the last may be missing;
    records that cannot be read any more; a log of which nothing is left."""


class LogStopped(_Signed):
    """The daemon ended by itself: all that left until then stands before."""

    kind: Literal["stop"] = "stop"
    """Kind of the entry."""
    at: Second
    """Time of the stop, to the second."""


class LogGap(_Signed):
    """Answers left without records, as the disk took none."""

    kind: Literal["gap"] = "gap"
    """Kind of the entry."""
    answers: int = Field(ge=1)
    """Number of answers without a record."""


class LogDropped(_Signed):
    """The oldest records were removed from the camera, to make room."""

    kind: Literal["dropped"] = "dropped"
    """Kind of the entry."""
    before: _Position
    """Position of the oldest that was kept."""


Entry = Annotated[
    LoggedCapture | LogStarted | LogStopped | LogGap | LogDropped, Field(discriminator="kind")
]


class LogRecord(_Signed):
    """One line of the log."""

    version: Literal[1] = LOG_VERSION
    """Version of the log's format."""
    device: str = Field(pattern=_DIGEST)
    """Public Ed25519 key of the device, 64 hexadecimal digits."""
    position: _Position
    """In the log, from 0 on."""
    previous: str = Field(pattern=_DIGEST)
    """SHA-256 of the line before; zeros at position 0."""
    entry: Entry
    """Content of the record."""
    signature: str = Field(repr=False, pattern=_SIGNATURE)
    """Ed25519 signature of all the rest, 128 hexadecimal digits."""


class LogHead(_Signed):
    """Signed end of the log: it shows what was dropped from its end since."""

    version: Literal[1] = LOG_VERSION
    """Version of the log's format."""
    device: str = Field(pattern=_DIGEST)
    """Public Ed25519 key of the device, 64 hexadecimal digits."""
    position: _Position
    """Position of the newest record."""
    record: str = Field(pattern=_DIGEST)
    """SHA-256 of its line."""
    oldest: _Position
    """Position of the oldest record that the camera keeps."""
    missed: int = Field(ge=0)
    """Answers that left since without records, as the disk takes none now."""
    at: Second
    """Time of the signature, to the second."""
    signature: str = Field(repr=False, pattern=_SIGNATURE)
    """Ed25519 signature of all the rest, 128 hexadecimal digits."""


class LogRecords(Answer):
    """Records in their order."""

    records: tuple[LogRecord, ...]
    """Records, the oldest first."""
    next: int | None = None
    """``after`` of the request for those that follow; None: there were no more."""


def _record() -> LogRecord:
    return LogRecord(
        device=EXAMPLE_DEVICE,
        position=1200,
        previous=EXAMPLE_DIGEST,
        entry=LoggedCapture(
            epoch=EXAMPLE_EPOCH,
            number=0,
            taken_at=EXAMPLE_TIME,
            mask=EXAMPLE_DIGEST,
            tested_s=120,
            calibration=None,
            answer=EXAMPLE_DIGEST,
        ),
        signature="0f" * 64,
    )


EXAMPLES = Examples(
    lambda: (
        LogRecords(records=(_record(),), next=1200),
        LogHead(
            device=EXAMPLE_DEVICE,
            position=1200,
            record=EXAMPLE_DIGEST,
            oldest=0,
            missed=0,
            at=EXAMPLE_TIME,
            signature="0f" * 64,
        ),
    )
)
