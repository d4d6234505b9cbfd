"""Clients of a daemon under siege: single requests, and event streams."""

from __future__ import annotations

import asyncio
import json
import ssl
import time
from collections import Counter
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import httpx

from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE

ATTACKER, NEIGHBOUR = "127.0.0.1", "127.0.0.2"
PATIENCE = 60.0
"""Longest wait for an answer [s]: a busy machine is no daemon that hangs."""


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer to ``question``, method and path; its status is 0 where none came."""

    question: str = ""
    status: int = 0
    body: bytes = b""
    headers: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0

    def json(self) -> Any:
        if self.status == 0:
            raise ConnectionError(f"no answer to {self.question} in {self.seconds:.1f} s")
        return json.loads(self.body)


@dataclass(frozen=True, slots=True)
class Address:
    """URL of a daemon, the PEM file of its certificate (None for plain HTTP), and a token."""

    url: str
    certificate: str | None = None
    token: str | None = field(default=None, repr=False)

    def with_token(self, token: str | None) -> Address:
        return replace(self, token=token)

    @property
    def headers(self) -> dict[str, str]:
        told = {} if self.token is None else {"Authorization": f"Bearer {self.token}"}
        return {"Connection": "close", **told}

    def context(self) -> ssl.SSLContext:
        return _context(self.certificate)

    async def ask(
        self,
        method: str,
        path: str,
        body: object = None,
        headers: Mapping[str, str] | None = None,
        *,
        source: str = NEIGHBOUR,
        patience: float = PATIENCE,
    ) -> Reply:
        content = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
        kind = {} if body is None else {"Content-Type": "application/json"}
        question, began = f"{method} {path}", time.monotonic()
        with suppress(httpx.HTTPError, OSError, TimeoutError):
            async with asyncio.timeout(patience), _client(self, source) as client:
                given = {**kind, **(headers or {})}
                answer = await client.request(method, path, content=content, headers=given)
                took = time.monotonic() - began
                return Reply(question, answer.status_code, answer.content, answer.headers, took)
        return Reply(question, seconds=time.monotonic() - began)

    async def get(self, name: str) -> Any:
        return (await self.ask("GET", f"/v1/{name}")).json()

    async def upload(self, bundle: bytes, patience: float = PATIENCE) -> Reply:
        kind = {"Content-Type": BUNDLE_MEDIA_TYPE}
        return await self.ask("POST", "/v1/bundles", bundle, kind, patience=patience)


@cache
def _context(certificate: str | None) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    if certificate is not None:
        context.load_verify_locations(certificate)
    return context


def _client(address: Address, source: str) -> httpx.AsyncClient:
    transport = httpx.AsyncHTTPTransport(verify=address.context(), local_address=source)
    return httpx.AsyncClient(
        transport=transport, base_url=address.url, headers=address.headers, timeout=None
    )


@dataclass
class EventStream:
    status: int = 0
    kinds: Counter[str] = field(default_factory=Counter)
    masks: list[str] = field(default_factory=list)
    ended: bool = False

    async def until(self, kind: str, count: int, patience: float = PATIENCE) -> bool:
        with suppress(TimeoutError):
            async with asyncio.timeout(patience):
                while self.kinds[kind] < count and not self.ended:
                    await asyncio.sleep(0.02)
        return self.kinds[kind] >= count

    async def read(self, address: Address, answered: asyncio.Event) -> None:
        try:
            async with (
                _client(address, NEIGHBOUR) as client,
                client.stream("GET", "/v1/events") as answer,
            ):
                self.status = answer.status_code
                answered.set()
                async for line in answer.aiter_lines():
                    name, _, value = line.partition(": ")
                    if name == "event":
                        self.kinds[value] += 1
                    elif name == "data" and '"kind":"mask"' in value:
                        self.masks.append(json.loads(value)["epoch"])
        except (httpx.HTTPError, OSError):
            pass
        finally:
            self.ended = True
            answered.set()


@asynccontextmanager
async def listening(address: Address) -> AsyncIterator[EventStream]:
    stream, answered = EventStream(), asyncio.Event()
    task = asyncio.create_task(stream.read(address, answered))
    try:
        with suppress(TimeoutError):
            async with asyncio.timeout(PATIENCE):
                await answered.wait()
        yield stream
    finally:
        task.cancel()
        await asyncio.wait([task])
