"""The ASGI application."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from veilcam_client import __version__
from veilcam_server import problems
from veilcam_server.idempotency import IdempotencyKeys
from veilcam_server.middleware import RequestContext
from veilcam_server.routes import router
from veilcam_server.service import Service

MAX_BODY = 16 * 1024
"""No request needs more than a few hundred bytes [bytes]."""


def create_app(service: Service) -> FastAPI:
    """Return the API of ``service``; its lifespan opens and closes the service."""

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with service.open():
            yield

    app = FastAPI(
        title="Veilcam",
        summary="A privacy camera without a lens.",
        version=__version__,
        lifespan=lifespan,
        openapi_url="/v1/openapi.json",
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
    app.state.idempotency = IdempotencyKeys()
    app.include_router(router)
    problems.install(app)
    app.add_middleware(RequestContext, max_body=MAX_BODY)
    return app
