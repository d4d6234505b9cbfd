"""HEAD for every route that has GET: the same answer without its body."""

from __future__ import annotations

import anyio
from starlette.types import ASGIApp, Message, Receive, Scope, Send


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
