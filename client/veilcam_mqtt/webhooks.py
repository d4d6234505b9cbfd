"""Webhooks: events as signed JSON, posted to somebody else's server.

Signed as Standard Webhooks 1.0 has it (https://www.standardwebhooks.com): HMAC-SHA256 of
``ID.TIMESTAMP.BODY``, so that any of its libraries can check them.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import hashlib
import hmac
import json
import logging
import secrets
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from urllib.parse import urlsplit

import httpx

PREFIX = "whsec_"
"""Of a secret, before its base64."""
LEAST_SECRET, MOST_SECRET = 24, 64
"""Length of a secret [bytes]."""
PAUSES = (1.0, 5.0, 30.0, 120.0)
"""Before each repetition [s]; then the event is dropped."""
TIMEOUT = 10.0
"""For one attempt [s]."""
WAITING = 64
"""Events that may wait for one receiver; the oldest are dropped."""
_AGAIN = frozenset((408, 425, 429))

log = logging.getLogger("veilcam.mqtt")


@dataclass(frozen=True, slots=True)
class Webhook:
    """Webhook: the address of its posts, and the key that signs them.

    Attributes:
        url: ``https://...``, or ``http://...``, where whoever listens reads labels.
        secret: ``whsec_`` and 24 to 64 bytes as base64.

    Raises:
        ValueError: a URL or a secret that is none; the message does not repeat the secret.
    """

    url: str = field(repr=False)
    secret: str = field(repr=False)

    def __post_init__(self) -> None:
        parts = urlsplit(self.url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError("a webhook's address is not valid: use https://HOST/PATH")
        try:
            size = len(self._key())
        except binascii.Error:
            size = 0
        if not self.secret.startswith(PREFIX) or not LEAST_SECRET <= size <= MOST_SECRET:
            raise ValueError(
                "the secret of webhooks is not valid: it is whsec_ and 24 to 64 bytes as base64"
            )

    def _key(self) -> bytes:
        return base64.b64decode(self.secret.removeprefix(PREFIX), validate=True)

    @property
    def name(self) -> str:
        """The receiver in a log: paths and queries may hold secrets."""
        return urlsplit(self.url).hostname or ""

    def headers(self, message_id: str, timestamp: int, body: bytes) -> dict[str, str]:
        """Headers of one attempt."""
        signed = f"{message_id}.{timestamp}.".encode() + body
        digest = hmac.new(self._key(), signed, hashlib.sha256).digest()
        return {
            "Content-Type": "application/json",
            "webhook-id": message_id,
            "webhook-timestamp": str(timestamp),
            "webhook-signature": f"v1,{base64.b64encode(digest).decode()}",
        }


class Delivery:
    """Posts events to one webhook, one after the other, each at most five times.

    Args:
        hook: webhook to post to.
        client: client that posts; it follows no redirection.
        sleep: waits so many seconds.
        clock: seconds since 1970.
    """

    def __init__(
        self,
        hook: Webhook,
        client: httpx.AsyncClient,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._hook, self._client, self._sleep, self._clock = hook, client, sleep, clock
        self._waiting: asyncio.Queue[tuple[str, bytes]] = asyncio.Queue(WAITING)

    def put(self, event: object) -> None:
        """Have an event posted, in the place of the oldest one where too many wait.

        Args:
            event: event that becomes JSON.
        """
        if self._waiting.full():
            self._waiting.get_nowait()
            self._waiting.task_done()
            log.warning("webhook %s is too slow: an event is dropped", self._hook.name)
        body = json.dumps(event, separators=(",", ":")).encode()
        self._waiting.put_nowait((f"msg_{secrets.token_hex(12)}", body))

    async def run(self) -> None:
        """Post what is put, for ever."""
        while True:
            await self._deliver(*await self._waiting.get())
            self._waiting.task_done()

    async def _deliver(self, message_id: str, body: bytes) -> None:
        for pause in (*PAUSES, None):
            said, again = await self._post(message_id, body)
            if said is None:
                return
            if pause is None or not again:
                log.warning("webhook %s: %s: an event is dropped", self._hook.name, said)
                return
            await self._sleep(pause)

    async def _post(self, message_id: str, body: bytes) -> tuple[str | None, bool]:
        """Return the fault, None if there was none; and whether it may go well later."""
        headers = self._hook.headers(message_id, int(self._clock()), body)
        try:
            # The answer's body is nobody's business, and may be without end: it is not read.
            async with (
                asyncio.timeout(TIMEOUT),
                self._client.stream(
                    "POST", self._hook.url, content=body, headers=headers
                ) as response,
            ):
                status = response.status_code
        except (httpx.HTTPError, TimeoutError) as error:
            return type(error).__name__, True
        if response.is_success:
            return None, False
        return f"HTTP {status}", status >= 500 or status in _AGAIN
