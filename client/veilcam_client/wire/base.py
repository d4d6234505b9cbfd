"""Common ground of the wire contract: the REST API, version 1.

The server answers with these models and the SDK reads them. What is asked is closed (a field that
is not known is refused); what is answered is open (a field that a newer server adds is ignored).
Times in seconds, wall-clock times in UTC. ``EXAMPLES`` of a module stand in the OpenAPI document.
"""

from __future__ import annotations

from datetime import UTC, datetime

from pydantic import BaseModel, ConfigDict

API_VERSION = 1


class Answer(BaseModel):
    """What a daemon answers: checked strictly, and open to what a newer one adds."""

    model_config = ConfigDict(strict=True, frozen=True, extra="ignore", allow_inf_nan=False)


class Nothing(Answer):
    """Nothing but that it was done: HTTP 204, without a body."""


class Question(BaseModel):
    """What a client asks: checked strictly, and closed to what is not known."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False)


EXAMPLE_TIME = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
EXAMPLE_EPOCH = "9f86d081884c7d659a2feaa0c55ad015"
EXAMPLE_DIGEST = "0f" * 32
