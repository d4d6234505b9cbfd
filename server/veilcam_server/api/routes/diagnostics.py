"""REST API of the daemon itself: status, metrics, diagnostics, and the API as a document."""

from __future__ import annotations

import platform
from importlib.metadata import version
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import Response
from prometheus_client import CONTENT_TYPE_LATEST

from veilcam_client.wire.diagnostics import Diagnostics
from veilcam_client.wire.status import Status
from veilcam_server.api.conditional import KNOWN, IfNoneMatch, unless_known
from veilcam_server.api.dependencies import AdmissionDep, ServiceDep, problems
from veilcam_server.api.metrics import Metrics
from veilcam_server.api.openapi import document
from veilcam_server.api.scopes import requires

PACKAGES = ("veilcam", "fastapi", "numpy", "pydantic", "starlette", "torch", "uvicorn")
"""Whose versions matter."""
AGING = {"uptime_s": True, "rotation": {"epoch_age_s"}}
"""What of the status only tells that time goes by."""

router = APIRouter(prefix="/v1", redirect_slashes=False)


@router.get(
    "/status",
    dependencies=[requires("read:status")],
    response_model=Status,
    responses={**KNOWN, **problems("invalid_request")},
)
async def status(service: ServiceDep, if_none_match: IfNoneMatch = "") -> Response:
    """State, device, bundle, rotation and queue.

    Its `ETag` changes with all of it but `uptime_s` and `epoch_age_s`.
    """
    return unless_known(service.status(), if_none_match, aging=AGING)


@router.get(
    "/metrics",
    dependencies=[requires("metrics")],
    response_class=Response,
    responses={
        200: {"content": {"text/plain": {"schema": {"type": "string"}}}},
        **problems(),
    },
)
async def metrics(request: Request) -> Response:
    """Captures, faults, state and latencies for Prometheus."""
    kept: Metrics = request.app.state.metrics
    return Response(kept.text(), media_type=CONTENT_TYPE_LATEST)


@router.get("/diagnostics", dependencies=[requires("read:status")], responses=problems())
async def diagnostics(service: ServiceDep, admission: AdmissionDep) -> Diagnostics:
    """Versions, settings without paths and labels, and the last states and faults."""
    history = service.history
    return Diagnostics(
        versions={
            "python": platform.python_version(),
            "system": f"{platform.system()} {platform.release()} {platform.machine()}",
            **{name: version(name) for name in PACKAGES},
        },
        settings=admission.settings,
        states=tuple(history.last_states),
        faults=tuple(history.last_faults),
        events=dict(history.events),
        fault_counts=dict(history.faults),
        audit_lost=0 if admission.audit is None else admission.audit.lost,
    )


@router.get("/openapi.json", dependencies=[requires("read:status")], responses=problems())
async def openapi(request: Request) -> dict[str, Any]:
    """This document."""
    app: FastAPI = request.app
    return document(app)
