"""REST API of the event stream."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent

from veilcam_client.wire.events import Believed, Event, Gone, Seen
from veilcam_server.api.dependencies import (
    AdmissionDep,
    CallerDep,
    ServiceDep,
    problems,
    requires,
    scores_for,
)
from veilcam_server.security.tokens import Caller
from veilcam_server.service.responses import told_sight

RETRY_MS = 1000
"""What a browser waits before it reconnects to the events."""
RECHECK = 1.0
"""A stream is not kept much longer than the token it was opened with [s]."""


LastEventId = Annotated[str | None, Header(max_length=128)]

router = APIRouter(prefix="/v1/events", redirect_slashes=False, tags=["Events"])


async def _stream_place(admission: AdmissionDep, caller: CallerDep) -> AsyncIterator[None]:
    with admission.streams_of_one.held(caller.id), admission.streams.held("all callers together"):
        yield


@router.get(
    "",
    dependencies=[requires("read:status"), Depends(_stream_place)],
    response_class=EventSourceResponse,
    responses=problems("invalid_request", "too_many_requests"),
)
async def events(
    request: Request,
    service: ServiceDep,
    admission: AdmissionDep,
    caller: CallerDep,
    last_event_id: LastEventId = None,
) -> AsyncIterator[ServerSentEvent]:
    """Stream events; resume with ``Last-Event-ID``, comments are heartbeats.

    Labels are among them where the token has the scope `classify`, confidences as scores are. The
    stream ends with the token.
    """
    # Before the first words, so that who has read them misses nothing any more.
    following = service.events(last_event_id, labels=caller.may("classify"))
    filled = request.app.state.sizes.filled
    yield filled(ServerSentEvent(retry=RETRY_MS))
    checked = time.monotonic()
    async for event in following:
        if time.monotonic() - checked >= RECHECK:
            if not admission.still_admits(request.headers):
                return
            checked = time.monotonic()
        if event is None:
            yield filled(ServerSentEvent())
        else:
            data = _told(event, caller).model_dump_json()
            yield filled(ServerSentEvent(raw_data=data, event=event.kind, id=event.id or None))


def _told(event: Event, caller: Caller) -> Event:
    """Return an event with the probabilities that a caller may see."""
    scores = scores_for(caller)
    if isinstance(event, Seen):
        return told_sight(event, scores)
    if isinstance(event, Gone):
        return told_sight(event, scores)
    if isinstance(event, Believed):
        belief = None if event.belief is None else told_sight(event.belief, scores)
        sighting = None if event.sighting is None else told_sight(event.sighting, scores)
        return event.model_copy(update={"belief": belief, "sighting": sighting})
    return event
