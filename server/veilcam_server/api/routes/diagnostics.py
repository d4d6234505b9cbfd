"""REST API of the daemon itself: status, metrics, diagnostics, and the API as a document."""

from __future__ import annotations

import asyncio
import math
import platform
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from importlib.metadata import version
from typing import Any, TypeAlias

from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import Response
from prometheus_client import CONTENT_TYPE_LATEST
from pydantic import JsonValue

from veilcam_client.wire.privacy import Privacy
from veilcam_client.wire.status import Diagnostics, DoctorFinding, DoctorFindings, Status
from veilcam_server.api.dependencies import AdmissionDep, ServiceDep, problems, requires
from veilcam_server.api.metrics import Metrics
from veilcam_server.api.openapi import document
from veilcam_server.doctor.finding import Finding
from veilcam_server.security.privacy import privacy_of
from veilcam_server.service.service import Service

Examine: TypeAlias = Callable[[], Iterable[Finding]]
"""What the doctor finds on the machine of a running daemon."""
CHECKUP_EVERY = 5.0
"""The machine is looked at no more often than that, whoever asks [s]."""
PACKAGES = ("veilcam", "fastapi", "numpy", "pydantic", "starlette", "torch", "uvicorn")
"""Whose versions matter."""


class Checkups:
    """Doctor of the machine of a running daemon, one examination at a time.

    Args:
        examine: takes a look, on a thread of its own: it reads the bundle, and asks programs.
        now: a clock that is never set [s].
    """

    def __init__(self, examine: Examine, now: Callable[[], float] = time.monotonic) -> None:
        self._examine, self._now = examine, now
        self._lock = asyncio.Lock()
        self._found, self._at = DoctorFindings(findings=()), -math.inf

    async def findings(self) -> DoctorFindings:
        """Those of the last look, or of a new one where that was a while ago."""
        async with self._lock:
            if self._now() - self._at >= CHECKUP_EVERY:
                found = await asyncio.to_thread(lambda: tuple(self._examine()))
                self._found = DoctorFindings(
                    findings=tuple(DoctorFinding(**asdict(each)) for each in found)
                )
                self._at = self._now()
            return self._found


def diagnostics_of(service: Service, settings: Mapping[str, JsonValue]) -> Diagnostics:
    """Return the diagnostics of a daemon.

    Args:
        service: service that is asked.
        settings: settings that may be told.
    """
    history = service.history
    return Diagnostics(
        versions={
            "python": platform.python_version(),
            "system": f"{platform.system()} {platform.release()} {platform.machine()}",
            **{name: version(name) for name in PACKAGES},
        },
        settings=settings,
        states=tuple(history.last_states),
        faults=tuple(history.last_faults),
        events=dict(history.events),
        fault_counts=dict(history.faults),
        log_missed=service.log.missed,
    )


router = APIRouter(prefix="/v1", redirect_slashes=False, tags=["Status"])


@router.get("/status", dependencies=[requires("read:status")], responses=problems())
async def status(service: ServiceDep) -> Status:
    """State, device, bundle, rotation and queue."""
    return service.status()


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
    """Return captures, faults, state and latencies for Prometheus."""
    kept: Metrics = request.app.state.metrics
    return Response(kept.text(), media_type=CONTENT_TYPE_LATEST)


@router.get("/diagnostics", dependencies=[requires("read:status")], responses=problems())
async def diagnostics(service: ServiceDep, admission: AdmissionDep) -> Diagnostics:
    """Versions, settings without paths and labels, and the last states and faults."""
    return diagnostics_of(service, admission.settings)


@router.get("/doctor", dependencies=[requires("read:status")], responses=problems())
async def doctor(request: Request) -> DoctorFindings:
    """Return the findings of the doctor on this machine, and remedies.

    It leaves out what needs panel or camera: `veilcamd doctor` looks, where no daemon runs.
    """
    checkups: Checkups = request.app.state.checkups
    return await checkups.findings()


@router.get("/privacy", dependencies=[requires("read:status")], responses=problems())
async def privacy(service: ServiceDep, admission: AdmissionDep) -> Privacy:
    """Return what somebody can learn from this camera as it is set up, and the switch for it."""
    given = admission.settings
    return privacy_of(
        service.release,
        beat=given.get("beat") != "off",
        full_scores=bool(given.get("full_scores")),
    )


@router.get("/openapi.json", dependencies=[requires("read:status")], responses=problems())
async def openapi(request: Request, admission: AdmissionDep) -> dict[str, Any]:
    """Return this document."""
    app: FastAPI = request.app
    return document(app, admission.site.root_path)
