"""Request of the API as data: what to send and how to read the answer."""

import reprlib
import uuid
from dataclasses import dataclass
from typing import Generic, TypeVar
from urllib.parse import quote

from pydantic import BaseModel

from veilcam_client.errors import ArgumentError

AnswerT = TypeVar("AnswerT", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Call(Generic[AnswerT]):
    """One request; with ``once`` it carries a key by which a repetition is known."""

    method: str
    path: str
    answer: type[AnswerT]
    body: BaseModel | bytes | None = None
    media_type: str = "application/json"
    once: bool = False
    accept: str = "application/json"

    def content(self) -> bytes | None:
        """Return the body as it is sent."""
        return (
            self.body.model_dump_json().encode() if isinstance(self.body, BaseModel) else self.body
        )

    def headers(self) -> dict[str, str]:
        """Headers of one request and of all its repetitions."""
        headers = {"Accept": self.accept, "Accept-Encoding": "identity"}
        if self.body is not None:
            headers["Content-Type"] = self.media_type
        if self.once:
            headers["Idempotency-Key"] = uuid.uuid4().hex
        return headers


def part(name: str, value: object) -> str:
    """Return a name as one part of a path; raises ArgumentError for one that cannot be."""
    if not isinstance(value, str) or value in ("", ".", ".."):
        raise ArgumentError(f"{name} = {reprlib.repr(value)} is not valid: use the one that it has")
    return quote(value, safe="")
