"""Responses of the API, made from what the engine knows."""

from __future__ import annotations

import time

from veilcam_client.wire.captures import (
    Capture,
    Classification,
    Embedding,
    Exposure,
    Prediction,
    Timing,
)
from veilcam_server.camera.capture import Captured


def capture_response(
    name: str, captured: Captured, embedding: Embedding, timing: Timing
) -> Capture:
    """One embedding as it may leave."""
    return Capture(
        id=name,
        taken_at=captured.taken_at,
        epoch=captured.epoch,
        scene=captured.scene,
        embedding=embedding,
        exposure=_exposure(captured),
        replay=captured.replay,
        timing=timing,
    )


def classification_response(
    name: str,
    captured: Captured,
    prediction: Prediction,
    embedding: Embedding | None,
    timing: Timing,
) -> Classification:
    """One label, with the embedding where it was asked for."""
    return Classification(
        id=name,
        taken_at=captured.taken_at,
        epoch=captured.epoch,
        scene=captured.scene,
        label=prediction.label,
        confidence=prediction.confidence,
        scores=prediction.scores,
        embedding=embedding,
        exposure=_exposure(captured),
        replay=captured.replay,
        timing=timing,
    )


def timing(
    captured: Captured, queued: float, begun: float, inference: float | None = None
) -> Timing:
    """Where the time went since ``begun``, monotonic [s]."""
    return Timing(
        queue_s=queued,
        rotation_s=captured.rotation_time,
        settle_s=captured.settle_time,
        capture_s=captured.capture_time,
        inference_s=inference,
        total_s=time.monotonic() - begun,
    )


def _exposure(captured: Captured) -> Exposure | None:
    if captured.replay is not None:
        # Whoever looks for the proof finds none: what was recorded stands in `replay`.
        return None
    return Exposure(
        started_after_shown_s=captured.started_after_shown,
        settle_s=captured.settle,
        duration_s=captured.duration,
    )
