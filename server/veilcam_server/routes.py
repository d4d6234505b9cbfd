"""REST API version 1."""

from __future__ import annotations

import hashlib
import io
from collections.abc import AsyncIterator
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends, Header, Request
from fastapi.responses import Response
from fastapi.sse import EventSourceResponse, ServerSentEvent
from starlette.exceptions import HTTPException

from veilcam_client.models import (
    NPY_MEDIA_TYPE,
    PROBLEM_MEDIA_TYPE,
    Capture,
    Classification,
    ClassificationRequest,
    Problem,
    Rotation,
    RotationPolicy,
    Status,
)
from veilcam_server.access import requires
from veilcam_server.idempotency import IdempotencyKeys
from veilcam_server.negotiation import preferred
from veilcam_server.problems import PROBLEMS
from veilcam_server.service import Service

RETRY_MS = 1000
"""What a browser waits before it reconnects to the events."""


def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


def _keys(request: Request) -> IdempotencyKeys:
    keys: IdempotencyKeys = request.app.state.idempotency
    return keys


async def _fingerprint(request: Request) -> bytes:
    head = f"{request.method} {request.url.path}\n".encode()
    return hashlib.sha256(head + await request.body()).digest()


ServiceDep = Annotated[Service, Depends(_service)]
KeysDep = Annotated[IdempotencyKeys, Depends(_keys)]
FingerprintDep = Annotated[bytes, Depends(_fingerprint)]
IdempotencyKey = Annotated[str | None, Header(pattern=r"^[\x21-\x7e]{1,128}$")]
LastEventId = Annotated[str | None, Header(max_length=128)]


def _problems(*codes: str) -> dict[int | str, dict[str, object]]:
    """OpenAPI entries for the problems that a route can answer with."""
    answers: dict[int | str, dict[str, object]] = {}
    for status in sorted({PROBLEMS[code].status for code in codes}):
        names = ", ".join(code for code in codes if PROBLEMS[code].status == status)
        answers[status] = {
            "description": names,
            "content": {PROBLEM_MEDIA_TYPE: {"schema": Problem.model_json_schema()}},
        }
    return answers


_ANY = ("bad_request", "forbidden", "host_refused", "internal_error")
_BODY = ("body_too_large", "invalid_request")
_DEVICE = (
    "queue_full",
    "not_ready",
    "rotation_impossible",
    "display_failed",
    "sensor_failed",
    "sensor_timeout",
    "fence_violated",
    "epoch_not_recorded",
    "idempotency_key_reused",
)

router = APIRouter(prefix="/v1", redirect_slashes=False)


@router.get("/status", dependencies=[requires("read:status")], responses=_problems(*_ANY))
async def status(service: ServiceDep) -> Status:
    """State, device, bundle, rotation and queue."""
    return service.status()


@router.post(
    "/captures",
    dependencies=[requires("read:embedding")],
    response_model=Capture,
    responses={
        200: {"content": {NPY_MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}}},
        **_problems(*_ANY, *_BODY, *_DEVICE, "embedding_withheld", "not_acceptable"),
    },
)
async def capture(
    service: ServiceDep,
    keys: KeysDep,
    fingerprint: FingerprintDep,
    accept: Annotated[str, Header()] = "*/*",
    idempotency_key: IdempotencyKey = None,
) -> Response:
    """Take one embedding; ``Accept: application/x-npy`` gives the array alone, as float32."""
    media_type = preferred(accept, ("application/json", NPY_MEDIA_TYPE))
    if media_type is None:
        raise HTTPException(406, f"captures come as application/json or {NPY_MEDIA_TYPE}")
    taken = await keys.once(idempotency_key, fingerprint, service.capture)
    if media_type == NPY_MEDIA_TYPE:
        buffer = io.BytesIO()
        np.save(buffer, np.asarray(taken), allow_pickle=False)
        names = {
            "Veilcam-Capture": taken.id,
            "Veilcam-Epoch": taken.epoch,
            "Veilcam-Form": taken.embedding.form,
        }
        return Response(buffer.getvalue(), headers=names, media_type=NPY_MEDIA_TYPE)
    return Response(taken.model_dump_json(), media_type="application/json")


@router.post(
    "/classifications",
    dependencies=[requires("classify")],
    responses=_problems(*_ANY, *_BODY, *_DEVICE, "embedding_withheld"),
)
async def classify(
    service: ServiceDep,
    keys: KeysDep,
    fingerprint: FingerprintDep,
    question: ClassificationRequest | None = None,
    idempotency_key: IdempotencyKey = None,
) -> Classification:
    """Take one embedding and classify it with what reads behind its own mask."""
    include_embedding = question is not None and question.include_embedding
    return await keys.once(
        idempotency_key,
        fingerprint,
        lambda: service.classify(include_embedding=include_embedding),
    )


@router.get("/rotation", dependencies=[requires("read:status")], responses=_problems(*_ANY))
async def rotation(service: ServiceDep) -> Rotation:
    """When masks change, and the present epoch."""
    return service.rotation()


@router.put(
    "/rotation",
    dependencies=[requires("mask:rotate")],
    responses=_problems(*_ANY, *_BODY, "rotation_impossible"),
)
async def set_rotation(service: ServiceDep, policy: RotationPolicy) -> Rotation:
    """Change when masks change: off, every N seconds, or every N captures."""
    return service.set_policy(policy)


@router.post(
    "/rotation/advance",
    dependencies=[requires("mask:rotate")],
    responses=_problems(*_ANY, *_BODY, *_DEVICE),
)
async def advance(
    service: ServiceDep,
    keys: KeysDep,
    fingerprint: FingerprintDep,
    idempotency_key: IdempotencyKey = None,
) -> Rotation:
    """Show another mask now."""
    return await keys.once(idempotency_key, fingerprint, service.rotate)


@router.get(
    "/events",
    dependencies=[requires("read:status")],
    response_class=EventSourceResponse,
    responses=_problems(*_ANY, "invalid_request"),
)
async def events(
    service: ServiceDep, last_event_id: LastEventId = None
) -> AsyncIterator[ServerSentEvent]:
    """Stream events; resume with ``Last-Event-ID``, comments are heartbeats."""
    yield ServerSentEvent(retry=RETRY_MS, comment="veilcam events")
    async for event in service.events(last_event_id):
        if event is None:
            yield ServerSentEvent(comment="heartbeat")
        else:
            yield ServerSentEvent(raw_data=event.model_dump_json(), event=event.kind, id=event.id)
