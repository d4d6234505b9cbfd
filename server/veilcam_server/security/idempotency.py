"""A request that is repeated with the same key is done once and answered twice."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, TypeVar, cast

from veilcam_server.errors import IdempotencyError

ResultT = TypeVar("ResultT")


@dataclass(frozen=True, slots=True)
class _Entry:
    fingerprint: bytes
    task: asyncio.Task[Any]
    since: float


class IdempotencyKeys:
    """Results by key for ``lifetime`` seconds, ``capacity`` at most. Failures are not kept."""

    def __init__(self, lifetime: float = 60.0, capacity: int = 128) -> None:
        self._lifetime, self._capacity = lifetime, capacity
        self._entries: dict[str, _Entry] = {}

    async def once(
        self,
        key: str | None,
        fingerprint: bytes,
        work: Callable[[], Coroutine[Any, Any, ResultT]],
    ) -> ResultT:
        """Return the result of ``work``, done once for ``key``, even if the caller goes away.

        Args:
            key: chosen by the client; None does the work every time.
            fingerprint: of the request: a key belongs to one.
            work: what to do.

        Raises:
            IdempotencyError: the key came before with another fingerprint.
        """
        if key is None:
            return await work()
        self._forget()
        entry = self._entries.get(key)
        if entry is None:
            entry = _Entry(fingerprint, asyncio.create_task(work()), time.monotonic())
            self._entries[key] = entry
            entry.task.add_done_callback(lambda task: self._drop_failure(key, task))
        elif entry.fingerprint != fingerprint:
            raise IdempotencyError(
                "this Idempotency-Key came before with another request: use a new key"
            )
        return cast(ResultT, await asyncio.shield(entry.task))

    def _drop_failure(self, key: str, task: asyncio.Task[Any]) -> None:
        if task.cancelled() or task.exception() is not None:
            entry = self._entries.get(key)
            if entry is not None and entry.task is task:
                del self._entries[key]

    def _forget(self) -> None:
        now = time.monotonic()
        old = [
            key
            for key, entry in self._entries.items()
            if entry.task.done() and now - entry.since > self._lifetime
        ]
        done = [key for key, entry in self._entries.items() if entry.task.done()]
        excess = max(0, len(self._entries) - self._capacity + 1)
        for key in {*old, *done[:excess]}:
            del self._entries[key]
