"""Sizes of answers: a route that tells what is seen has one, whatever it answers.

Heads and bodies are filled up apart, as each leaves in TLS records of its own. So a listener learns
neither the length of a label nor whether a capture failed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from http import HTTPStatus

from fastapi.sse import ServerSentEvent, format_sse_event
from starlette.datastructures import MutableHeaders
from starlette.types import Message, Scope, Send

from veilcam_client.wire.base import PROBLEM_MEDIA_TYPE
from veilcam_server.security.site import security_headers
from veilcam_server.service.service import Service

CAPTURES, CLASSIFICATIONS = "/v1/captures", "/v1/classifications"
WATCH, STATUS, DIAGNOSTICS = "/v1/watch", "/v1/status", "/v1/diagnostics"
EVENTS = "/v1/events"
PATHS = (CAPTURES, CLASSIFICATIONS, WATCH, STATUS, DIAGNOSTICS)
"""Routes of one size."""
PADDING_HEADER = "Veilcam-Padding"
"""Header that fills up the head of an answer."""

BLOCK = 256
"""Sizes are multiples of it [bytes]."""
_OWN_HEADERS = 768
"""Room in a head for all headers but those for browsers [bytes]."""
_JSON = ("application/json", PROBLEM_MEDIA_TYPE)


class Sizes:
    """Sizes of the answers of one daemon, for the bundle in use and its form of release.

    Args:
        service: service that is asked.
        longest: function that returns the length of each route's longest body.
        frame_ancestors: origins of the pages that may show it in a frame.
    """

    def __init__(
        self,
        service: Service,
        longest: Callable[[Service], Mapping[str, int]],
        frame_ancestors: tuple[str, ...],
    ) -> None:
        self._service, self._longest = service, longest
        fixed = security_headers(frame_ancestors).items()
        self._head = _blocks(_OWN_HEADERS + sum(len(name) + len(value) for name, value in fixed))
        self._bodies: dict[tuple[str, str], Mapping[str, int]] = {}

    def body(self, path: str, *, embedding: bool) -> int:
        """Return the size of the bodies of a route [bytes].

        Args:
            path: path of the route.
            embedding: True where the answer to a classification holds its embedding.
        """
        service = self._service
        key = service.bundle.digest, service.release
        if key not in self._bodies:
            lengths = self._longest(service)
            self._bodies = {key: {name: _blocks(length) for name, length in lengths.items()}}
        return self._bodies[key][CAPTURES if embedding else path]

    def filled(self, event: ServerSentEvent) -> ServerSentEvent:
        """Return an event with a comment that gives it the size of all events."""
        said = {"data_str": event.raw_data, "event": event.event, "id": event.id}
        length = len(format_sse_event(**said, retry=event.retry, comment=""))
        comment = " " * (_blocks(length, self.body(EVENTS, embedding=False)) - length)
        return event.model_copy(update={"comment": comment})

    def padded(self, scope: Scope, send: Send) -> Send:
        """Return ``send`` for a request, with answers of one size where its route has one."""
        if scope["path"] not in PATHS:
            return send
        held: list[Message] = []

        async def give(message: Message) -> None:
            held.append(message)
            if message["type"] == "http.response.body" and not message.get("more_body"):
                start, body = held[0], b"".join(each.get("body", b"") for each in held[1:])
                held.clear()
                body = self._filled(scope, start, body)
                await send(start)
                await send({"type": "http.response.body", "body": body})

        return give

    def _filled(self, scope: Scope, start: Message, body: bytes) -> bytes:
        """Fill up the head of an answer in place, and return its body filled up."""
        headers = MutableHeaders(scope=start)
        if headers.get("content-type") in _JSON:
            size = self.body(scope["path"], embedding=scope["state"].get("embedding", False))
            body = body.ljust(_blocks(max(1, len(body)), size))
            headers["Content-Length"] = str(len(body))
            # A proxy that compresses would undo it.
            headers["Cache-Control"] = "no-store, no-transform"
        headers[PADDING_HEADER] = ""
        used = len(HTTPStatus(start["status"]).phrase)
        used += sum(len(name) + len(value) for name, value in start["headers"])
        used += len(": \r\n") * len(start["headers"])
        headers[PADDING_HEADER] = "0" * (_blocks(used + 1, self._head) - used)
        return b"" if scope["method"] == "HEAD" else body


def _blocks(length: int, block: int = BLOCK) -> int:
    """Return the multiple of a block that holds something of a length."""
    return block * math.ceil(length / block)
