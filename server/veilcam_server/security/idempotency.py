"""A request that is repeated with the same key is done once and answered twice."""

from __future__ import annotations

import asyncio
import hashlib
import math
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any, TypeVar, cast

import structlog

from veilcam_server.errors import ProblemError
from veilcam_server.security.key_record import LIFETIME, KeyRecord
from veilcam_server.system.logs import Throttle

ResultT = TypeVar("ResultT")

KEPT = 256
"""Answers to one caller that are kept. One of 24 x 32 values is 30 kB, so that they are 8 MB."""
CAPACITY = 8192
"""Keys of one caller in a minute. Who asks no more often than the settings allow by default, 100
times a second, never has so many."""

_REUSED = "this Idempotency-Key came before with another request: use a new key"

log = structlog.get_logger()


@dataclass(slots=True)
class _Entry:
    fingerprint: bytes
    since: float
    task: asyncio.Task[Any] | None = None
    """None where the answer is not kept any more."""

    @property
    def done(self) -> bool:
        return self.task is None or self.task.done()


@dataclass(slots=True)
class _Room:
    """Keys of one caller, the oldest first."""

    entries: OrderedDict[bytes, _Entry] = field(default_factory=OrderedDict)
    answered: deque[bytes] = field(default_factory=deque)

    def forget(self, before: float) -> None:
        """Forget keys that are older, and answers for which there is no room."""
        while self.entries:
            first = next(iter(self.entries.values()))
            if first.since >= before or not first.done:
                break
            self.entries.popitem(last=False)
        while len(self.answered) > KEPT:
            oldest = self.entries.get(self.answered.popleft())
            if oldest is not None and oldest.done:
                oldest.task = None


class IdempotencyKeys:
    """Keys and answers of the last minute; every caller has room of its own. Failures are not kept.

    Lives on one event loop.

    Args:
        record: tells what was done before a restart; None where nobody needs to know.
        now: a clock that is never set [s].
    """

    def __init__(
        self, record: KeyRecord | None = None, now: Callable[[], float] = time.monotonic
    ) -> None:
        self._record, self._now = record, now
        self._rooms: dict[str, _Room] = {}
        self._before = {} if record is None else record.read()
        self._started = now()
        self._not_written = Throttle()

    async def once(
        self,
        caller: str,
        key: str | None,
        fingerprint: bytes,
        work: Callable[[], Coroutine[Any, Any, ResultT]],
    ) -> ResultT:
        """Return the result of ``work``, done once for ``key``, even if the caller goes away.

        Args:
            caller: caller whose key it is.
            key: chosen by the client; None does the work every time.
            fingerprint: digest of the request: a key belongs to one.
            work: function that does the work.

        Raises:
            ProblemError: the key came before with another fingerprint, the answer is lost, or the
                caller has used too many keys.
        """
        if key is None:
            return await work()
        self._forget()
        name = hashlib.sha256(f"{caller}\n{key}".encode()).digest()
        self._require_new(name, fingerprint)
        room = self._rooms.setdefault(caller, _Room())
        entry = room.entries.get(name)
        if entry is None:
            entry = self._begin(room, name, fingerprint, work)
        elif entry.fingerprint != fingerprint:
            raise ProblemError("idempotency_key_reused", _REUSED)
        if entry.task is None:
            raise ProblemError(
                "answer_lost",
                "what this Idempotency-Key asks for was done, and its answer made room for later "
                "ones: look what is the case now, or ask again with a new key",
            )
        return cast(ResultT, await asyncio.shield(entry.task))

    def _begin(
        self,
        room: _Room,
        name: bytes,
        fingerprint: bytes,
        work: Callable[[], Coroutine[Any, Any, ResultT]],
    ) -> _Entry:
        now = self._now()
        if len(room.entries) >= CAPACITY:
            oldest = next(iter(room.entries.values()))
            pause = max(1, math.ceil(oldest.since + LIFETIME - now))
            raise ProblemError(
                "too_many_requests",
                f"{CAPACITY} of your idempotency keys are remembered: try again in {pause} s",
                retry_after=pause,
            )
        task = asyncio.create_task(self._do(name, fingerprint, work))
        entry = room.entries[name] = _Entry(fingerprint, now, task)
        room.answered.append(name)

        def drop_failure(task: asyncio.Task[Any]) -> None:
            if task.cancelled() or task.exception() is not None:
                room.entries.pop(name, None)

        task.add_done_callback(drop_failure)
        return entry

    async def _do(
        self, name: bytes, fingerprint: bytes, work: Callable[[], Coroutine[Any, Any, ResultT]]
    ) -> ResultT:
        """Do the work, and write down that it was done before anybody hears of it."""
        result = await work()
        if self._record is not None:
            try:
                await asyncio.to_thread(self._record.add, name, fingerprint)
            except OSError as error:
                # A full disk stops no capture. The key holds until the daemon ends.
                if (count := self._not_written.due()) is not None:
                    log.warning(
                        "idempotency keys will not survive a restart",
                        error=error.strerror,
                        times=count,
                    )
        return result

    def _require_new(self, name: bytes, fingerprint: bytes) -> None:
        """Raise what tells of a key that came before the restart."""
        if name in self._before:
            if self._before[name] != fingerprint:
                raise ProblemError("idempotency_key_reused", _REUSED)
            raise ProblemError(
                "answer_lost",
                "what this Idempotency-Key asks for was done, and its answer was lost when the "
                "daemon was restarted: look what is the case now, or ask again with a new key",
            )

    def _forget(self) -> None:
        limit = self._now() - LIFETIME
        if self._before and self._started < limit:
            self._before = {}
        for caller, room in tuple(self._rooms.items()):
            room.forget(limit)
            if not room.entries:
                del self._rooms[caller]
