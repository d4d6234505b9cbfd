"""Idempotency keys, which hold for one run of the daemon."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any, TypeVar, cast

from veilcam_client.wire.base import UNKNOWN_RUN
from veilcam_client.wire.captures import Embedding
from veilcam_server.errors import ProblemError

ResultT = TypeVar("ResultT")

LIFETIME = 60.0
"""Time for which an answer is kept [s]."""
KEPT = 256
"""Answers to one caller that are kept. One of 24 x 32 values is 30 kB, so that they are 8 MB."""
MEASUREMENTS = 4
"""Answers to one caller that are kept with an open embedding: it is what the sensor measured."""
CAPACITY = 4096
"""Keys of one caller that are remembered."""
CALLERS = 1024
"""Callers whose keys are remembered."""


@dataclass(slots=True)
class _Entry:
    fingerprint: bytes
    task: asyncio.Task[Any] | None
    """None where the answer is not kept any more."""

    @property
    def open(self) -> bool:
        """Return whether an answer is kept that has an open embedding."""
        kept = None if self.task is None else self.task.result()
        return isinstance(getattr(kept, "embedding", None), Embedding)


@dataclass(slots=True)
class _CallerKeys:
    """Keys of one caller, the oldest first."""

    entries: OrderedDict[str, _Entry] = field(default_factory=OrderedDict)
    answered: deque[tuple[float, _Entry]] = field(default_factory=deque)

    def forget(self, before: float) -> None:
        """Forget older answers, and answers for which there is no room."""
        while self.answered and (self.answered[0][0] < before or len(self.answered) > KEPT):
            self.answered.popleft()[1].task = None
        for each in [entry for _, entry in self.answered if entry.open][:-MEASUREMENTS]:
            each.task = None


class IdempotencyKeys:
    """Keys of each caller with their answers. Failures are not kept.

    Lives on one event loop.

    Args:
        now: a clock that is never set [s].
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.run = secrets.token_hex(16)
        """Name of this run of the daemon."""
        self._now = now
        self._callers: OrderedDict[str, _CallerKeys] = OrderedDict()

    def require_run(self, caller: str, key: str, run: str | None) -> None:
        """Raise :class:`ProblemError` for a key of another run of the daemon.

        Args:
            caller: caller whose key it is.
            key: chosen by the client.
            run: run that the key belongs to; None: this one.
        """
        known = self._callers.get(caller, _CallerKeys()).entries
        if run not in (None, self.run) and not (run == UNKNOWN_RUN and key in known):
            raise ProblemError(
                "answer_lost",
                "the daemon was restarted since, and does not know whether this Idempotency-Key "
                "came before: look what is the case now, or ask again with the present Veilcam-Run",
            )

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
            ProblemError: the key came before with another fingerprint, or the answer is not kept.
        """
        if key is None:
            return await work()
        for each in self._callers.values():
            each.forget(self._now() - LIFETIME)
        keys = self._callers.setdefault(caller, _CallerKeys())
        self._callers.move_to_end(caller)
        if len(self._callers) > CALLERS:
            self._callers.popitem(last=False)
        entry = keys.entries.get(key) or self._begin(keys, key, fingerprint, work)
        if entry.fingerprint != fingerprint:
            raise ProblemError(
                "idempotency_key_reused",
                "this Idempotency-Key came before with another request: use a new key",
            )
        if entry.task is None:
            raise ProblemError(
                "answer_lost",
                "what this Idempotency-Key asks for was done, and its answer is not kept any more: "
                "look what is the case now, or ask again with a new key",
            )
        return cast(ResultT, await asyncio.shield(entry.task))

    def _begin(
        self,
        keys: _CallerKeys,
        key: str,
        fingerprint: bytes,
        work: Callable[[], Coroutine[Any, Any, ResultT]],
    ) -> _Entry:
        task = asyncio.create_task(work())
        entry = keys.entries[key] = _Entry(fingerprint, task)
        if len(keys.entries) > CAPACITY:
            done = (
                name for name, each in keys.entries.items() if not each.task or each.task.done()
            )
            keys.entries.pop(next(done, ""), None)

        def forget() -> None:
            keys.forget(self._now() - LIFETIME)

        def end(task: asyncio.Task[Any]) -> None:
            if task.cancelled() or task.exception() is not None:
                keys.entries.pop(key, None)
            else:
                keys.answered.append((self._now(), entry))
                forget()
                task.get_loop().call_later(LIFETIME + 1, forget)

        task.add_done_callback(end)
        return entry
