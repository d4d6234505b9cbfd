"""Longest answers of the routes that tell what is seen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np
from pydantic import JsonValue
from pydantic_core import to_json

from veilcam_client.keys.blocks import NOTES_BYTES
from veilcam_client.wire.base import Answer
from veilcam_client.wire.calibration import CalibrationRun
from veilcam_client.wire.captures import Classification, Embedding, Replay, SealedEmbedding
from veilcam_client.wire.events import (
    EVENT_KINDS,
    Believed,
    BundleChanged,
    CalibrationChanged,
    Classified,
    Event,
    Fault,
    StateChanged,
    WatchChanged,
)
from veilcam_client.wire.rotation import EverySeconds, Preparation, Rotation
from veilcam_client.wire.sealing import MOST_RECEIVERS, Envelope, PairedReceiver, Release, SealedKey
from veilcam_client.wire.status import PastFault, PastState, Queue, Remedy, WallClock
from veilcam_client.wire.watch import MOST_SIGHTINGS, Belief, QuietHours, Sighting, Watch, Watching
from veilcam_server.api.problems import example_of
from veilcam_server.api.routes.diagnostics import diagnostics_of
from veilcam_server.api.sizes import CAPTURES, CLASSIFICATIONS, DIAGNOSTICS, EVENTS, STATUS, WATCH
from veilcam_server.errors import PROBLEMS
from veilcam_server.service.events import LENGTH
from veilcam_server.service.service import Service

_NUMBER, _COUNT, _SMALL = -1.7976931348623157e308, 10**15, np.float32(-1.1754942e-38)
_TIME = datetime(2026, 1, 2, 3, 4, 5, 678901, UTC)
_NAME, _DIGEST, _CLOCK = "0f" * 16, "0f" * 32, WallClock(zone="z" * 64, synchronised=False)
_REMEDY: Remedy = "check_panel_wiring"
_DETAIL = "x" * 224
"""Longest reason of a state or a fault; a longer one may make an answer of twice the size."""


def longest_bodies(service: Service, settings: Mapping[str, JsonValue]) -> Mapping[str, int]:
    """Return the length of the longest body of each route [bytes].

    Args:
        service: service that is asked.
        settings: settings that its diagnostics tell.
    """
    bundle, status = service.bundle, service.status()
    longest = max(bundle.labels, key=lambda label: len(to_json(label)))
    told: dict[str, Any] = {"label": longest, "confidence": _NUMBER, "duration_s": _NUMBER}
    taken: dict[str, Any] = {
        "id": 3 * _NAME,
        "epoch": _NAME,
        "number": _COUNT,
        "taken_at": _TIME,
        "replay": Replay(capture=3 * _NAME, place=_COUNT),
    }
    scores = dict.fromkeys(bundle.labels, _NUMBER)
    classification = Classification(
        **taken, label=longest, confidence=_NUMBER, scores=scores, embedding=None
    )
    embedded = _embedding(service.release, bundle.embedding_shape)
    watch = Watch(
        policy=Watching(rate_hz=1 / 3, quiet=QuietHours(begin="22:00", end="07:00")),
        activity="on_request",
        detail=_DETAIL,
        looks=_COUNT,
        belief=Belief(**told, since=_TIME, looks=_COUNT),
        history=MOST_SIGHTINGS * (Sighting(**told, seen_at=_TIME, gone_at=_TIME),),
        clock=_CLOCK,
    )
    receiver = PairedReceiver(id=_DIGEST, label=64 * '"', added_at=_TIME)
    rotation = Rotation(
        policy=EverySeconds(seconds=86400 / 7, jitter=1 / 3, reuse=10**6),
        epoch=_NAME,
        epoch_age_s=_NUMBER,
        captures=_COUNT,
        preparation=Preparation(
            ready=False, prepared=_COUNT, last_s=_NUMBER, late=_COUNT, reused=_COUNT
        ),
    )
    status = status.model_copy(
        update={
            "state": "calibrating",
            "detail": _DETAIL,
            "remedy": _REMEDY,
            "uptime_s": _NUMBER,
            "captures": _COUNT,
            "release": "sealed",
            "clock": _CLOCK,
            "receivers": MOST_RECEIVERS * (receiver,),
            "rotation": rotation,
            "queue": Queue(waiting=_COUNT, limit=_COUNT),
        }
    )
    past = PastState(at=_TIME, state="calibrating", detail=_DETAIL, remedy=_REMEDY)
    fault = PastFault(at=_TIME, code="calibration_impossible", detail=_DETAIL, remedy=_REMEDY)
    diagnosed = diagnostics_of(service, settings).model_copy(
        update={
            "states": LENGTH * (past,),
            "faults": LENGTH * (fault,),
            "log_missed": _COUNT,
            "events": dict.fromkeys(EVENT_KINDS, _COUNT),
            "fault_counts": dict.fromkeys(PROBLEMS, _COUNT),
        }
    )
    answers = {CLASSIFICATIONS: classification, WATCH: watch, STATUS: status}
    sizes = {path: _length(answer) for path, answer in {**answers, DIAGNOSTICS: diagnosed}.items()}
    sizes[EVENTS] = max(
        len(to_json(event)) + len(event.kind) for event in _events(watch, longest)
    ) + len(f"event: \ndata: \nid: {_NAME[:8]}-{_COUNT}\n: \n\n")
    return {**sizes, CAPTURES: _length(classification.model_copy(update={"embedding": embedded}))}


def _events(watch: Watch, label: str) -> tuple[Event, ...]:
    """Return the longest events, of a watch and a label that are the longest."""
    named: dict[str, Any] = {"id": f"{_NAME[:8]}-{_COUNT}", "at": _TIME}
    run = CalibrationRun(
        stage="measuring",
        scene="dark",
        instruction=None,
        exposures=_COUNT,
        total=_COUNT,
        detail=_DETAIL,
    )
    return (
        Believed(**named, belief=watch.belief, sighting=watch.history[0]),
        Classified(**named, capture=_NAME[:16], epoch=_NAME, label=label),
        WatchChanged(**named, policy=watch.policy, activity="on_request", detail=_DETAIL),
        StateChanged(**named, state="calibrating", detail=_DETAIL, remedy=_REMEDY),
        Fault(**named, code="calibration_impossible", detail=_DETAIL, remedy=_REMEDY),
        BundleChanged(**named, digest=_DIGEST, task=64 * "t", version=_COUNT),
        CalibrationChanged(**named, run=run),
    )


def _length(longest: Answer) -> int:
    """Return the length of a route's longest body, problems included [bytes]."""
    problem = max(len(to_json(example_of(code))) for code in PROBLEMS) + 2 * len(_DETAIL)
    return max(len(longest.model_dump_json().encode()), problem)


def _embedding(form: Release, shape: tuple[int, ...]) -> Embedding | SealedEmbedding | None:
    """Return the longest embedding of a form."""
    count = math.prod(shape)
    if form == "none":
        return None
    if form != "sealed":
        return Embedding(form=form, shape=shape, values=np.full(count, _SMALL, np.float32))
    # Authenticated encryption adds 16 bytes, and HPKE 48; base64 has 4 digits for 3 bytes.
    sealed = 4 * count + NOTES_BYTES + 16
    key = SealedKey(receiver=_DIGEST, key=4 * math.ceil((32 + 48) / 3) * "0")
    keys = tuple(key.model_copy() for _ in range(MOST_RECEIVERS))
    envelope = Envelope.model_construct(
        device=_DIGEST, epoch=_NAME, bundle=_DIGEST, keys=keys, signature=2 * _DIGEST
    )
    return SealedEmbedding(shape=shape, block=4 * math.ceil(sealed / 3) * "0", envelope=envelope)
