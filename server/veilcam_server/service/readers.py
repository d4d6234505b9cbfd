"""Readers: the thread on which captures become answers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import ParamSpec, TypeVar

from veilcam_client.wire.captures import Capture, Classification
from veilcam_server.camera.capture import Captured
from veilcam_server.masks.source import Evidence
from veilcam_server.security.log import Log
from veilcam_server.service.responses import (
    Scores,
    capture_response,
    classification_response,
    logged,
)

P = ParamSpec("P")
ResultT = TypeVar("ResultT")


class Readers:
    """Reads captures one after the other, while the device serves the next. Lets go of each.

    Args:
        log: log that has an answer before anybody else.
    """

    def __init__(self, log: Log) -> None:
        self._log = log
        self._thread = ThreadPoolExecutor(1, "readers")

    async def classification(
        self,
        name: str,
        captured: Captured,
        scores: Scores,
        queued: float | None,
        caller: str | None,
    ) -> Classification:
        """Return the label of a capture.

        Args:
            name: id of the answer.
            captured: capture to read.
            scores: scores that are told beside the label.
            queued: time that the request waited for the device [s]; None: the embedding stays.
            caller: caller that the answer leaves to.
        """
        return await self._do(captured, self._label, name, captured, scores, queued, caller)

    async def embedding(
        self, name: str, captured: Captured, queued: float, caller: str | None
    ) -> Capture:
        """Return the embedding of a capture; arguments as of :meth:`classification`."""
        return await self._do(captured, self._release, name, captured, queued, caller)

    async def evidence(self, captured: Captured) -> Evidence:
        """Return the evidence of a capture, of which nothing leaves."""
        return await self._do(captured, captured.evidence)

    def close(self) -> None:
        """End the thread once it is idle."""
        self._thread.shutdown()

    def _label(
        self,
        name: str,
        captured: Captured,
        scores: Scores,
        queued: float | None,
        caller: str | None,
    ) -> Classification:
        prediction = captured.classify()
        embedding = None if queued is None else captured.release(queued)
        answer = classification_response(name, captured, prediction, embedding, scores)
        self._write(answer, captured, caller)
        return answer

    def _release(self, name: str, captured: Captured, queued: float, caller: str | None) -> Capture:
        answer = capture_response(name, captured, captured.release(queued))
        self._write(answer, captured, caller)
        return answer

    def _write(
        self, answer: Capture | Classification, captured: Captured, caller: str | None
    ) -> None:
        """Write an answer to the log; what is replayed is not logged."""
        if captured.provenance is not None:
            facts = logged(answer, captured.provenance, caller)
            self._log.append("capture", facts, at=answer.taken_at)

    async def _do(
        self, captured: Captured, work: Callable[P, ResultT], *args: P.args, **given: P.kwargs
    ) -> ResultT:
        try:
            future = self._thread.submit(work, *args, **given)
        except BaseException:
            captured.done()
            raise
        # Also of one that is called off before its turn, as nobody waits for it any more.
        future.add_done_callback(lambda _: captured.done())
        return await asyncio.wrap_future(future)
