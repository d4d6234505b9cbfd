"""The ASGI application."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from veilcam_client import __version__
from veilcam_server.api import problems
from veilcam_server.api.metrics import Metrics
from veilcam_server.api.middleware import RequestContext
from veilcam_server.api.routes.bundles import PREFIX as KEYRINGS
from veilcam_server.api.routes.bundles import router as keyring_router
from veilcam_server.api.routes.calibration import router as calibration_router
from veilcam_server.api.routes.captures import router
from veilcam_server.api.routes.diagnostics import router as diagnostics_router
from veilcam_server.api.routes.lease import router as lease_router
from veilcam_server.api.routes.simulation import MAX_PICTURE
from veilcam_server.api.routes.simulation import PATH as SCENE
from veilcam_server.api.routes.simulation import router as simulation_router
from veilcam_server.api.routes.tokens import router as token_router
from veilcam_server.security.admission import Gateway
from veilcam_server.security.idempotency import IdempotencyKeys
from veilcam_server.service.service import Service

MAX_BODY = 16 * 1024
"""No request needs more than a few hundred bytes, but for uploads [bytes]."""


def create_app(service: Service, gateway: Gateway | None = None) -> FastAPI:
    """Return the API of ``service``; its lifespan opens and closes the service.

    Args:
        service: what the API does.
        gateway: who may ask; without one everybody on this machine may, as tests want it.
    """
    gateway = gateway or Gateway()

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with service.open():
            yield

    app = FastAPI(
        title="Veilcam",
        summary="A privacy camera without a lens.",
        version=__version__,
        lifespan=lifespan,
        # Served by a route of our own, which wants a scope like every other.
        openapi_url=None,
        # Interactive pages load scripts from elsewhere; a camera calls nobody.
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        telemetry={
            "tracing": False,
            "metrics": False,
            "logs": False,
            "operation_spans": False,
            "auto_configure": False,
        },
    )
    app.state.service = service
    app.state.gateway = gateway
    app.state.metrics = metrics = Metrics(service, gateway.audit)
    app.state.idempotency = IdempotencyKeys()
    app.include_router(router)
    app.include_router(lease_router)
    app.include_router(token_router)
    app.include_router(diagnostics_router)
    app.include_router(calibration_router)
    app.include_router(keyring_router)
    app.include_router(simulation_router)
    problems.install(app)
    app.add_middleware(
        RequestContext,
        gateway=gateway,
        metrics=metrics,
        max_body=MAX_BODY,
        max_uploads={("POST", KEYRINGS): service.keyrings.limit, ("PUT", SCENE): MAX_PICTURE},
    )
    return app
