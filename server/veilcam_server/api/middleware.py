"""Middleware of every request: id, caller, body, entry in the log, last resort, and HEAD."""

from __future__ import annotations

import asyncio
import re
import secrets
import time
from collections.abc import Collection, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial

import anyio
import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from veilcam_client.wire.base import RUN_HEADER
from veilcam_server.api.metrics import Metrics
from veilcam_server.api.problems import error_response, problem_response
from veilcam_server.api.sizes import Sizes
from veilcam_server.errors import ProblemError, StorageError
from veilcam_server.security.admission import Admission
from veilcam_server.security.site import call_header, security_headers
from veilcam_server.system.logs import log_defect

_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
MAX_PATH = 128
"""Longest path that the log repeats."""
_LOGGED = ("/v1/captures", "/v1/classifications")
"""Answers there have an entry of their own, which names the caller."""

log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class Body:
    """Body that a route takes.

    Attributes:
        limit: largest size [bytes].
        media_types: media types, one of which the request has to name.
        required: True where an empty body needs a media type too.
    """

    limit: int
    media_types: tuple[str, ...] = ("application/json",)
    required: bool = False

    def require_media_type(self, headers: Headers) -> None:
        """Raise :class:`ProblemError` unless the body has one of the media types.

        A page of another site can make a browser send text and forms without asking first; none of
        these types is among them (https://fetch.spec.whatwg.org/#cors-safelisted-request-header).
        """
        length = headers.get("content-length", "").strip("0")
        empty = not length and "transfer-encoding" not in headers
        given = headers.get("content-type", "").partition(";")[0].strip().lower()
        if (self.required or not empty) and given not in self.media_types:
            raise ProblemError(
                "unsupported_media_type",
                f"send it with Content-Type: {' or '.join(self.media_types)}",
            )


@dataclass(slots=True)
class _Answer:
    """State of one request so far."""

    status: int = 0
    refused: bool = False


class RequestContext:
    """Pure ASGI, so that event streams pass through unbuffered."""

    def __init__(
        self,
        app: ASGIApp,
        admission: Admission,
        metrics: Metrics,
        *,
        open_paths: Collection[str],
        claim: str,
        passing: Collection[str],
        body: Body,
        uploads: Mapping[tuple[str, str], Body],
        sizes: Sizes,
    ) -> None:
        self._app, self._admission, self._metrics = app, admission, metrics
        self._open_paths, self._body, self._uploads = open_paths, body, uploads
        self._claim = claim
        self._passing, self._sizes = passing, sizes
        self._headers = security_headers(admission.site.frame_ancestors)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        path = self._admission.site.below_root(scope["path"])
        # Its links are relative: the page is at a path with a slash at its end.
        moved = path is None
        scope["path"] = path or "/"
        headers = Headers(scope=scope)
        asked = headers.get("x-request-id", "")
        request_id = asked if _REQUEST_ID.fullmatch(asked) else secrets.token_hex(8)
        state = scope.setdefault("state", {})
        state.update(request_id=request_id, caller=None, problem=None, noted={})
        state["echoed"] = call_header(headers)
        peer = _peer(scope)
        body = self._uploads.get((scope["method"], scope["path"]), self._body)
        begun = time.monotonic()

        answer = _Answer()
        send = self._sizes.padded(scope, send)
        send_with_id = self._sender(scope, receive, send, answer)

        try:
            with ExitStack() as stack:
                try:
                    self._admission.site.require(scope["method"], scope["path"], headers)
                    if moved:
                        to = {"Location": f"{self._admission.site.root_path}/"}
                        await Response(status_code=308, headers=to)(scope, receive, send_with_id)
                        return
                    # No limit: an answer that everybody gets costs no more than a refusal.
                    if (scope["method"], scope["path"]) == ("POST", self._claim):
                        stack.enter_context(self._admission.claiming(peer))
                    elif not self._is_open(scope):
                        admitted = self._admission.admitted(headers, peer)
                        state["caller"] = stack.enter_context(admitted)
                    body.require_media_type(headers)
                    if self._is_change(scope):
                        await asyncio.to_thread(self._admission.require_log)
                except ProblemError as error:
                    response = error_response(scope, error)
                    await response(scope, receive, send_with_id)
                    return
                await self._app(scope, _limited(receive, body.limit), send_with_id)
        except ClientDisconnect:
            # There is nobody to answer, and whoever wants to may break off without end.
            log.debug("broken off", request_id=request_id)
        except Exception as error:
            log_defect(error, request_id=request_id)
            if answer.status:
                raise
            response = problem_response(
                scope,
                "internal_error",
                "the daemon has a defect: its log tells more under this request id",
            )
            await response(scope, receive, send_with_id)
        finally:
            # The signed log has what was done. A line for every question would let anybody fill the
            # disk under the log.
            log.debug(
                "request",
                request_id=request_id,
                method=scope["method"],
                path=scope["path"],
                status=answer.status,
                ms=round(1e3 * (time.monotonic() - begun), 1),
            )

    def _sender(self, scope: Scope, receive: Receive, send: Send, answer: _Answer) -> Send:
        """Note the answer, count it, and give it an id; or refuse it, where it cannot be noted."""
        state, begun = scope["state"], time.monotonic()

        async def give(message: Message) -> None:
            if message["type"] == "http.response.start":
                answer.status = message["status"]
                fields = MutableHeaders(scope=message)
                fields["X-Request-Id"] = state["request_id"]
                fields[RUN_HEADER] = self._admission.keys.run
                fields.update(state["echoed"])
                # A page says itself what it loads.
                for name, value in self._headers.items():
                    fields.setdefault(name, value)
                # What has a tag may be kept, and says so itself.
                if "ETag" not in fields:
                    fields["Cache-Control"] = "no-store"
                await self._enter(scope, answer.status, _peer(scope))
                self._metrics.observe(*_names(scope), answer.status, time.monotonic() - begun)
            await send(message)

        async def give_or_refuse(message: Message) -> None:
            if answer.refused:
                return  # the rest of what is not answered
            try:
                await give(message)
            except StorageError as error:
                answer.refused = True
                await error_response(scope, error)(scope, receive, give)

        return give_or_refuse

    def _is_open(self, scope: Scope) -> bool:
        return scope["method"] in ("GET", "HEAD") and scope["path"] in self._open_paths

    def _is_change(self, scope: Scope) -> bool:
        """Return whether an action has to be in the log on disk before it is acknowledged."""
        return scope["method"] not in ("GET", "HEAD") and scope["path"] not in self._passing

    async def _enter(self, scope: Scope, status: int, peer: str) -> None:
        """Note everything but what was only read; who watches the events learns what is seen.

        Raises:
            StorageError: a change cannot be noted.
        """
        path, state = scope["path"], scope["state"]
        only_read = scope["method"] in ("GET", "HEAD") and path != "/v1/events"
        # A monitor that is told 'no' is not refused.
        well = state["problem"] is None
        if well and (only_read or path in _LOGGED):
            return
        durable = status < 400 and self._is_change(scope)
        note = partial(
            self._admission.note,
            state["caller"],
            f"{scope['method']} {path[:MAX_PATH]}",
            code=state["problem"],
            durable=durable,
            status=status,
            request=state["request_id"],
            peer=peer,
            **state["noted"],
        )
        if durable:
            await asyncio.to_thread(note)
        else:
            note()


def _limited(receive: Receive, limit: int) -> Receive:
    """Stop reading a body that is too large, whatever length it claims to have."""
    received = 0

    async def receive_some() -> Message:
        nonlocal received
        message = await receive()
        received += len(message.get("body", b""))
        if received > limit:
            raise HTTPException(413, f"this request has at most {limit} bytes")
        return message

    return receive_some


def _peer(scope: Scope) -> str:
    return scope["client"][0] if scope.get("client") else "local socket"


def _names(scope: Scope) -> tuple[str, str]:
    """Return method and template of the route, or a word for both: labels are never free text."""
    route = scope.get("route")
    if not isinstance(route, Route):
        return "other", "none"
    # HEAD is answered wherever GET is.
    method, known = scope["method"], route.methods or set()
    return method if {method, {"HEAD": "GET"}.get(method)} & known else "other", route.path


class HeadRequests:
    """Lets the application answer as to GET, and ends that answer after its head."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return
        inner = {**scope, "method": "GET"}
        # An event stream would go on for ever.
        with anyio.CancelScope() as answered:

            async def send_head(message: Message) -> None:
                if message["type"] == "http.response.start":
                    # Which route it was, as the router found out.
                    scope.update(inner, method="HEAD")
                    await send(message)
                    await send({"type": "http.response.body"})
                    answered.cancel()

            await self._app(inner, receive, send_head)
