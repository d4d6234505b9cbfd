"""Around every request: its id, host check, body limit, log line, and the last resort."""

from __future__ import annotations

import re
import secrets
import time
import traceback

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from veilcam_server.access import ANYONE
from veilcam_server.problems import problem_response

_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_LOOPBACK = re.compile(r"(localhost|127(\.\d{1,3}){3}|\[::1\])(:\d{1,5})?", re.IGNORECASE)

log = structlog.get_logger()


class RequestContext:
    """Pure ASGI, so that event streams pass through unbuffered."""

    def __init__(self, app: ASGIApp, max_body: int) -> None:
        self._app, self._max_body = app, max_body

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        asked = headers.get("x-request-id", "")
        request_id = asked if _REQUEST_ID.fullmatch(asked) else secrets.token_hex(8)
        scope.setdefault("state", {})["request_id"] = request_id
        scope["state"]["caller"] = ANYONE
        status = 0
        begun = time.monotonic()

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                answer = MutableHeaders(scope=message)
                answer["X-Request-Id"] = request_id
                answer["Cache-Control"] = "no-store"
            await send(message)

        try:
            # A page in a browser can make its own name resolve to this machine (DNS rebinding);
            # the Host header then betrays it.
            if not _LOOPBACK.fullmatch(headers.get("host", "")):
                response = problem_response(
                    code="host_refused",
                    detail="this daemon answers to localhost only: use http://localhost:PORT",
                    instance=scope["path"],
                    request_id=request_id,
                )
                await response(scope, receive, send_with_id)
                return
            await self._app(scope, self._limited(receive), send_with_id)
        except Exception as error:
            # The text of an error that nobody foresaw may hold anything, so it is not logged.
            log.error(
                "defect",
                request_id=request_id,
                error=type(error).__name__,
                where=[
                    f"{frame.filename}:{frame.lineno} {frame.name}"
                    for frame in traceback.extract_tb(error.__traceback__)
                ],
            )
            if status:
                raise
            response = problem_response(
                code="internal_error",
                detail="the daemon has a defect: its log tells more under this request id",
                instance=scope["path"],
                request_id=request_id,
            )
            await response(scope, receive, send_with_id)
        finally:
            log.info(
                "request",
                request_id=request_id,
                method=scope["method"],
                path=scope["path"],
                status=status,
                ms=round(1e3 * (time.monotonic() - begun), 1),
            )

    def _limited(self, receive: Receive) -> Receive:
        """Stop reading a body that is too large, whatever length it claims to have."""
        received = 0

        async def receive_some() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > self._max_body:
                raise HTTPException(413, f"a request has at most {self._max_body} bytes")
            return message

        return receive_some
