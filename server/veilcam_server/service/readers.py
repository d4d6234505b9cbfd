"""Readers: the thread on which captures become answers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import ParamSpec, TypeVar

from veilcam_client.wire.captures import Capture, Classification
from veilcam_server.camera.capture import Captured
from veilcam_server.masks.source import Evidence
from veilcam_server.sealing.capture_log import CaptureLog
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
        log: log that has an answer before anybody else; None: a recording is replayed.
    """

    def __init__(self, log: CaptureLog | None) -> None:
        self._log = log
        self._thread = ThreadPoolExecutor(1, "readers")

    async def classification(
        self, name: str, captured: Captured, scores: Scores, queued: float | None
    ) -> Classification:
        """Return the label of a capture.

        Args:
            name: id of the answer.
            captured: capture to read.
            scores: scores that are told beside the label.
            queued: time that the request waited for the device [s]; None: the embedding stays.
        """
        return await self._do(captured, self._label, name, captured, scores, queued)

    async def embedding(self, name: str, captured: Captured, queued: float) -> Capture:
        """Return the embedding of a capture; arguments as of :meth:`classification`."""
        return await self._do(captured, self._release, name, captured, queued)

    async def evidence(self, captured: Captured) -> Evidence:
        """Return the evidence of a capture, of which nothing leaves."""
        return await self._do(captured, captured.evidence)

    def close(self) -> None:
        """End the thread once it is idle."""
        self._thread.shutdown()

    def _label(
        self, name: str, captured: Captured, scores: Scores, queued: float | None
    ) -> Classification:
        prediction = captured.classify()
        embedding = None if queued is None else captured.release(queued)
        answer = classification_response(name, captured, prediction, embedding, scores)
        self._write(answer, captured)
        return answer

    def _release(self, name: str, captured: Captured, queued: float) -> Capture:
        answer = capture_response(name, captured, captured.release(queued))
        self._write(answer, captured)
        return answer

    def _write(self, answer: Capture | Classification, captured: Captured) -> None:
        if self._log is not None and captured.provenance is not None:
            self._log.append(logged(answer, captured.provenance))

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
