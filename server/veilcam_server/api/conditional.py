"""Conditional requests (RFC 9110, section 13): an answer that a caller has is not sent again."""

from __future__ import annotations

import hashlib
import re
from typing import Annotated, Any

from fastapi import Header
from fastapi.responses import Response
from pydantic import BaseModel

IfNoneMatch = Annotated[str, Header(max_length=4096)]
KNOWN: dict[int | str, dict[str, Any]] = {
    304: {"description": "The caller has it: `If-None-Match` names its `ETag`."}
}
"""OpenAPI entry of a route whose answer has an ETag."""

_TAG = re.compile(r'"([\x21\x23-\x7e]*)"')


def unless_known(answer: BaseModel, if_none_match: str) -> Response:
    """Return ``answer`` with its ETag, or 304 without a body where the caller has it.

    Args:
        answer: answer to send.
        if_none_match: header of the request, empty where it has none.
    """
    said = answer.model_dump_json()
    tag = hashlib.sha256(said.encode()).hexdigest()[:32]
    # Kept by who asked and by nobody else, and only to ask whether it still holds.
    headers = {"ETag": f'W/"{tag}"', "Cache-Control": "private, no-cache"}
    if has(if_none_match, tag):
        return Response(status_code=304, headers=headers)
    return Response(said, headers=headers, media_type="application/json")


def has(if_none_match: str, tag: str) -> bool:
    """Return whether a caller who sends this header has the answer with this tag."""
    return if_none_match.strip() == "*" or tag in _TAG.findall(if_none_match)
