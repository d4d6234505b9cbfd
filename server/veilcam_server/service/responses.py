"""Responses of the API: what may be said in the clear, and nothing else.

All else that is known of a capture depends on the light or tells of other callers; it is sealed
with the embedding, or stays here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, TypeVar

from veilcam_client.keys.commitments import answer_digest
from veilcam_client.wire.captures import (
    Capture,
    Classification,
    Embedding,
    Prediction,
    SealedEmbedding,
)
from veilcam_client.wire.events import Gone, Seen
from veilcam_client.wire.watch import Belief, Sighting
from veilcam_server.camera.capture import Captured, Provenance

SightT = TypeVar("SightT", Belief, Sighting, Seen, Gone)

AGE_STEP = 60
"""Step of the age of a self test in the log [s]: when light ended one early is not told."""
Scores = Literal["none", "tenths", "all"]
"""What is told of a label's probability: nothing, tenths, or all of it."""


def capture_response(
    name: str, captured: Captured, embedding: Embedding | SealedEmbedding
) -> Capture:
    """One embedding as it may leave."""
    return Capture(
        id=name,
        epoch=captured.epoch,
        number=captured.number,
        taken_at=captured.taken_at,
        embedding=embedding,
        replay=captured.replay,
    )


def classification_response(
    name: str,
    captured: Captured,
    prediction: Prediction,
    embedding: Embedding | SealedEmbedding | None,
    scores: Scores,
) -> Classification:
    """One label, with the embedding where it was asked for."""
    told = _told(prediction, scores)
    return Classification(
        id=name,
        epoch=captured.epoch,
        number=captured.number,
        taken_at=captured.taken_at,
        label=told.label,
        confidence=told.confidence,
        scores=told.scores,
        embedding=embedding,
        replay=captured.replay,
    )


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


def _told(prediction: Prediction, scores: Scores) -> Prediction:
    """Return a prediction as a caller may see it."""
    if scores == "all":
        return prediction
    if scores == "none":
        return Prediction(label=prediction.label)
    return Prediction(
        label=prediction.label,
        confidence=told_confidence(prediction.confidence, scores),
        scores=_tenths(prediction.scores),
    )


def told_confidence(confidence: float | None, scores: Scores) -> float | None:
    """Return a probability as a caller may see it."""
    if confidence is None or scores == "none":
        return None
    return confidence if scores == "all" else round(confidence, 1)


def told_sight(sight: SightT, scores: Scores) -> SightT:
    """Return a sight with its probability as a caller may see it."""
    return sight.model_copy(update={"confidence": told_confidence(sight.confidence, scores)})


def _tenths(scores: Mapping[str, float] | None) -> Mapping[str, float] | None:
    if scores is None:
        return None
    return {label: round(score, 1) for label, score in scores.items()}
