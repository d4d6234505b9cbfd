"""Responses of the API, and the readers that make them: what may be said in the clear.

All else that is known of a capture depends on the light or tells of other callers; it is sealed
with the embedding, or stays here.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal, ParamSpec, TypeVar

from veilcam_client.keys.commitments import answer_digest
from veilcam_client.wire.captures import Capture, Classification, Prediction
from veilcam_client.wire.events import Gone, Seen
from veilcam_client.wire.watch import Belief, Sighting
from veilcam_server.camera.capture import Captured, Provenance
from veilcam_server.masks.source import Evidence
from veilcam_server.security.log import Log

SightT = TypeVar("SightT", Belief, Sighting, Seen, Gone)

AGE_STEP = 60
"""Step of the age of a self test in the log [s]: when light ended one early is not told."""
Scores = Literal["none", "tenths", "all"]
"""What is told of a label's probability: nothing, tenths, or all of it."""


def logged(
    answer: Capture | Classification, provenance: Provenance, caller: str | None
) -> dict[str, str | int]:
    """Return the facts for the log of an answer that is about to leave to a caller."""
    facts: dict[str, str | int | None] = {
        "epoch": answer.epoch,
        "number": answer.number,
        "mask": provenance.mask,
        "tested_s": AGE_STEP * math.ceil(provenance.tested / AGE_STEP),
        "calibration": provenance.calibration,
        "answer": answer_digest(answer),
        "caller": caller,
    }
    return {name: value for name, value in facts.items() if value is not None}


def _named(name: str, captured: Captured) -> dict[str, Any]:
    """Return what every answer tells of a capture."""
    return {
        "id": name,
        "epoch": captured.epoch,
        "number": captured.number,
        "taken_at": captured.taken_at,
        "replay": captured.replay,
    }


def _told(prediction: Prediction, scores: Scores) -> Prediction:
    """Return a prediction as a caller may see it."""
    if scores == "all":
        return prediction
    if scores == "none":
        return Prediction(label=prediction.label)
    scored = prediction.scores
    return Prediction(
        label=prediction.label,
        confidence=told_confidence(prediction.confidence, scores),
        scores=scored and {label: round(score, 1) for label, score in scored.items()},
    )


def told_confidence(confidence: float | None, scores: Scores) -> float | None:
    """Return a probability as a caller may see it."""
    if confidence is None or scores == "none":
        return None
    return confidence if scores == "all" else round(confidence, 1)


def told_sight(sight: SightT, scores: Scores) -> SightT:
    """Return a sight with its probability as a caller may see it."""
    return sight.model_copy(update={"confidence": told_confidence(sight.confidence, scores)})


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
        told = _told(captured.classify(), scores)
        answer = Classification(
            **_named(name, captured),
            **dict(told),
            embedding=None if queued is None else captured.release(queued),
        )
        self._write(answer, captured, caller)
        return answer

    def _release(self, name: str, captured: Captured, queued: float, caller: str | None) -> Capture:
        answer = Capture(**_named(name, captured), embedding=captured.release(queued))
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
