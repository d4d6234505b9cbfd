"""REST API of the watch."""

from __future__ import annotations

from fastapi import APIRouter

from veilcam_client.wire.watch import Watch, WatchPolicy
from veilcam_server.api.dependencies import (
    BODY,
    CallerDep,
    ServiceDep,
    problems,
    requires,
    scores_for,
    unleased,
)
from veilcam_server.security.tokens import Caller
from veilcam_server.service.responses import told_sight

PATH = "/v1/watch"

router = APIRouter(prefix=PATH, redirect_slashes=False, tags=["Watch"])


@router.get("", dependencies=[requires("read:status")], responses=problems("not_enabled"))
async def watch(service: ServiceDep, caller: CallerDep) -> Watch:
    """Watch of the camera, and what it believes to see.

    Labels are told for `classify`, and confidences as scores are.
    """
    return _told(service.watcher.state(), caller)


@router.put(
    "",
    dependencies=[requires("mask:rotate"), unleased()],
    responses=problems(*BODY, "leased", "not_ready", "display_failed", "not_enabled"),
)
async def set_watch(service: ServiceDep, caller: CallerDep, policy: WatchPolicy) -> Watch:
    """Let the camera look by itself, or on request alone, or not at all; also after a restart."""
    return _told(await service.set_watch(policy), caller)


def _told(found: Watch, caller: Caller) -> Watch:
    """Return a watch as a caller may see it."""
    if not caller.may("classify"):
        # A watch that waits may do so because the light changed, as somebody came.
        activity = "looking" if found.activity == "waiting" else found.activity
        shown = {"activity": activity, "detail": None} if activity != found.activity else {}
        return found.model_copy(update={"belief": None, "history": (), "looks": 0, **shown})
    scores, belief = scores_for(caller), found.belief
    if belief is not None:
        belief = told_sight(belief, scores)
    history = tuple(told_sight(each, scores) for each in found.history)
    return found.model_copy(update={"belief": belief, "history": history})
