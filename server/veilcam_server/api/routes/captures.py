"""REST API version 1."""

from __future__ import annotations

import io
import time
from collections.abc import AsyncIterator, Sequence
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends, Header, Request
from fastapi.responses import Response
from fastapi.sse import EventSourceResponse, ServerSentEvent

from veilcam_client.wire.captures import (
    NPY_MEDIA_TYPE,
    Capture,
    Classification,
    ClassificationRequest,
)
from veilcam_client.wire.events import Classified
from veilcam_client.wire.rotation import Rotation, RotationPolicy
from veilcam_client.wire.status import Status
from veilcam_server.api.dependencies import BODY, GatewayDep, OnceDep, ServiceDep, problems
from veilcam_server.api.problems import NotAcceptableError
from veilcam_server.api.routes.lease import unleased
from veilcam_server.security.caller import Caller, CallerDep, requires
from veilcam_server.service.service import Service


def preferred(accept: str, offers: Sequence[str]) -> str | None:
    """Return the offer with the highest quality, the first of equals, or None if none will do.

    Args:
        accept: the Accept header, e.g. ``application/x-npy, application/json;q=0.5``.
        offers: media types in order of the server's own preference.
    """
    ranges = [_parse(item) for item in accept.split(",")]
    best, best_quality = None, 0.0
    for offer in offers:
        # The most specific range decides, whatever its quality.
        matches = [
            (specific, quality)
            for pattern, quality in ranges
            if (specific := _match(pattern, offer))
        ]
        quality = max(matches, default=(0, 0.0))[1]
        if quality > best_quality:
            best, best_quality = offer, quality
    return best


def _parse(item: str) -> tuple[str, float]:
    media_type, *parameters = (part.strip().lower() for part in item.split(";"))
    for parameter in parameters:
        if parameter.startswith("q="):
            try:
                return media_type, min(1.0, max(0.0, float(parameter[2:])))
            except ValueError:
                return media_type, 0.0
    return media_type, 1.0


def _match(pattern: str, offer: str) -> int:
    """3 for the type itself, 2 for its family, 1 for anything, 0 for no match."""
    if pattern == offer:
        return 3
    if pattern == f"{offer.partition('/')[0]}/*":
        return 2
    return 1 if pattern == "*/*" else 0


RETRY_MS = 1000
"""What a browser waits before it reconnects to the events."""
RECHECK = 1.0
"""A stream is not kept much longer than the token it was opened with [s]."""


LastEventId = Annotated[str | None, Header(max_length=128)]
DEVICE = (
    "leased",
    "queue_full",
    "calibrating",
    "not_ready",
    "rotation_impossible",
    "display_failed",
    "sensor_failed",
    "sensor_timeout",
    "fence_violated",
    "epoch_not_recorded",
    "replaying",
    "replay_over",
)
"""What a route that needs the device can answer with besides."""

router = APIRouter(prefix="/v1", redirect_slashes=False)


async def _stream_place(gateway: GatewayDep) -> AsyncIterator[None]:
    with gateway.streams.held():
        yield


def _require_embedding(caller: Caller, service: Service) -> None:
    """Before anything is captured: what leaves here must not leave for this caller otherwise."""
    caller.require("read:embedding")
    if service.release == "raw":
        caller.require("read:embedding:raw")


@router.get("/status", dependencies=[requires("read:status")], responses=problems())
async def status(service: ServiceDep) -> Status:
    """State, device, bundle, rotation and queue."""
    return service.status()


@router.post(
    "/captures",
    dependencies=[requires("read:embedding"), unleased()],
    response_model=Capture,
    responses={
        200: {"content": {NPY_MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}}},
        **problems(*BODY, *DEVICE, "embedding_withheld", "not_acceptable"),
    },
)
async def capture(
    service: ServiceDep,
    caller: CallerDep,
    once: OnceDep,
    accept: Annotated[str, Header()] = "*/*",
) -> Response:
    """Take one embedding; ``Accept: application/x-npy`` gives the array alone, as float32."""
    _require_embedding(caller, service)
    media_type = preferred(accept, ("application/json", NPY_MEDIA_TYPE))
    if media_type is None:
        raise NotAcceptableError(f"captures come as application/json or {NPY_MEDIA_TYPE}")
    taken = await once(service.capture)
    if media_type == NPY_MEDIA_TYPE:
        buffer = io.BytesIO()
        np.save(buffer, np.asarray(taken), allow_pickle=False)
        names = {
            "Veilcam-Capture": taken.id,
            "Veilcam-Epoch": taken.epoch,
            "Veilcam-Form": taken.embedding.form,
        }
        if taken.replay is not None:
            names["Veilcam-Replay"] = str(taken.replay.place)
        return Response(buffer.getvalue(), headers=names, media_type=NPY_MEDIA_TYPE)
    return Response(taken.model_dump_json(), media_type="application/json")


@router.post(
    "/classifications",
    dependencies=[requires("classify"), unleased()],
    responses=problems(*BODY, *DEVICE, "embedding_withheld", "inference_failed"),
)
async def classify(
    service: ServiceDep,
    caller: CallerDep,
    once: OnceDep,
    question: ClassificationRequest | None = None,
) -> Classification:
    """Take one embedding and classify it with what reads behind its own mask."""
    include_embedding = question is not None and question.include_embedding
    if include_embedding:
        _require_embedding(caller, service)
    return await once(lambda: service.classify(include_embedding=include_embedding))


@router.get("/rotation", dependencies=[requires("read:status")], responses=problems())
async def rotation(service: ServiceDep) -> Rotation:
    """When masks change, and the present epoch."""
    return service.rotation()


@router.put(
    "/rotation",
    dependencies=[requires("mask:rotate"), unleased()],
    responses=problems(*BODY, "leased", "rotation_impossible", "replaying"),
)
async def set_rotation(service: ServiceDep, policy: RotationPolicy) -> Rotation:
    """Change when masks change: off, every N seconds, or every N captures."""
    return service.set_policy(policy)


@router.post(
    "/rotation/advance",
    dependencies=[requires("mask:rotate"), unleased()],
    responses=problems(*BODY, *DEVICE),
)
async def advance(
    service: ServiceDep,
    once: OnceDep,
) -> Rotation:
    """Show another mask now."""
    return await once(service.rotate)


@router.get(
    "/events",
    dependencies=[requires("read:status"), Depends(_stream_place)],
    response_class=EventSourceResponse,
    responses=problems("invalid_request", "too_many_streams"),
)
async def events(
    request: Request,
    service: ServiceDep,
    gateway: GatewayDep,
    caller: CallerDep,
    last_event_id: LastEventId = None,
) -> AsyncIterator[ServerSentEvent]:
    """Stream events; resume with ``Last-Event-ID``, comments are heartbeats.

    Labels are among them where the token has the scope `classify`. The stream ends with the token.
    """
    yield ServerSentEvent(retry=RETRY_MS, comment="veilcam events")
    checked = time.monotonic()
    async for event in service.events(last_event_id):
        if time.monotonic() - checked >= RECHECK:
            if not gateway.still_admits(request.headers):
                return
            checked = time.monotonic()
        if event is None:
            yield ServerSentEvent(comment="heartbeat")
        elif not isinstance(event, Classified) or "classify" in caller.scopes:
            yield ServerSentEvent(raw_data=event.model_dump_json(), event=event.kind, id=event.id)
