"""The wire contract of the log: signed records, each of which names the one before."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Annotated, ClassVar, Literal, TypeAlias

from pydantic import AfterValidator, ConfigDict, Field

from veilcam_client.wire.base import EXAMPLE_DIGEST, EXAMPLE_TIME, Answer, Result
from veilcam_client.wire.sealing import EXAMPLE_DEVICE

RECORDS_AT_ONCE = 1000
"""In one answer at most: some 700 kB."""
Kind: TypeAlias = Literal[
    "capture", "request", "refused", "command", "start", "stop", "gap", "dropped", "damage"
]
"""Kinds of records."""
_Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


def _whole_second(at: datetime) -> datetime:
    if at.utcoffset() != timedelta(0) or at.microsecond:
        raise ValueError("is not valid: use a whole second of UTC")
    return at


class LogRecord(Result):
    """One line of the log; closed, so that nothing unknown stands beside what is signed."""

    model_config: ClassVar[ConfigDict] = ConfigDict(
        strict=True, frozen=True, extra="forbid", defer_build=True
    )

    version: Literal[1] = 1
    """Version of the log's format."""
    device: _Digest
    """Public Ed25519 key of the device, 64 hexadecimal digits."""
    position: int = Field(ge=0, lt=2**63)
    """In the log, from 0 on."""
    previous: _Digest
    """SHA-256 of the line before; zeros at position 0."""
    kind: Kind
    """Kind of the record: an answer that left, an action, or something that befell the log."""
    at: Annotated[datetime, AfterValidator(_whole_second)]
    """Time of the capture or of the record, to the second."""
    facts: Mapping[str, str | int]
    """Facts by name, such as ``epoch`` and ``answer``, or ``action`` and ``status``."""
    signature: str = Field(repr=False, pattern=r"^[0-9a-f]{128}$")
    """Ed25519 signature of all the rest, 128 hexadecimal digits."""


class LogRecords(Answer):
    """Records in their order."""

    records: tuple[LogRecord, ...]
    """Records, the oldest first."""
    next: int | None = None
    """``after`` of the request for those that follow; None: there were no more."""


def examples() -> tuple[LogRecords]:
    """Return examples for documents."""
    record = LogRecord(
        device=EXAMPLE_DEVICE,
        position=1200,
        previous=EXAMPLE_DIGEST,
        kind="request",
        at=EXAMPLE_TIME,
        facts={"action": "PUT /v1/rotation", "status": 200, "caller": "3f9a1c20", "label": "lamp"},
        signature="0f" * 64,
    )
    return (LogRecords(records=(record,), next=1200),)
