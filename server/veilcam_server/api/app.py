"""The ASGI application."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial

from fastapi import FastAPI

from veilcam_client import __version__
from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_client.wire.simulation import PICTURE_MEDIA_TYPES
from veilcam_server.api import problems
from veilcam_server.api.longest import longest_bodies
from veilcam_server.api.metrics import Metrics
from veilcam_server.api.middleware import Body, HeadRequests, RequestContext
from veilcam_server.api.routes import (
    bundles,
    calibration,
    captures,
    diagnostics,
    events,
    lease,
    log,
    page,
    pairing,
    public,
    receivers,
    rotation,
    session,
    simulation,
    tokens,
    watch,
)
from veilcam_server.api.sizes import Sizes
from veilcam_server.gate.protocol import Connections
from veilcam_server.security.admission import Admission
from veilcam_server.service.service import Service

MAX_BODY = 16 * 1024
"""No request needs more than a few hundred bytes, but for uploads [bytes]."""
_PASSING = (
    *("/v1/captures", "/v1/classifications", "/v1/rotation/advance", "/v1/lease"),
    *(simulation.PATH, session.PATH, watch.PATH),
)
"""Of what is done there a restart leaves nothing, or it is to switch the camera off: a full disk
under the log stops none of it, and its line may be lost where the power is."""
_ROUTES = (
    *(captures, rotation, events, lease, log, tokens, receivers, pairing, diagnostics, calibration),
    *(bundles, session, simulation, watch, public, page),
)


def create_app(
    service: Service,
    admission: Admission | None = None,
    connections: Connections | None = None,
    examine: diagnostics.Examine = tuple,
) -> FastAPI:
    """Return the API of ``service``; its lifespan opens and closes the service.

    Args:
        service: service behind the API.
        admission: admission of callers; None, as in tests, lets in everybody on this machine.
        connections: connections at the gate, for the metrics; None where there is no gate.
        examine: tells what the doctor finds on this machine.
    """
    admission = admission or Admission()

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with service.open():
            yield

    app = FastAPI(
        title="Veilcam",
        summary="A privacy camera without a lens.",
        version=__version__,
        license_info={"name": "Apache License 2.0", "identifier": "Apache-2.0"},
        # An operation is called what the SDK calls it.
        generate_unique_id_function=lambda route: route.name,
        lifespan=lifespan,
        exception_handlers=problems.HANDLERS,
        # Served by a route of our own, which wants a scope like every other.
        openapi_url=None,
        # FastAPI's pages load scripts from elsewhere; a camera calls nobody.
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
    service.give_way(lambda: admission.lease.holding is not None)
    app.state.admission = admission
    app.state.checkups = diagnostics.Checkups(examine)
    app.state.metrics = metrics = Metrics(service, connections)
    app.state.sizes = Sizes(
        service,
        partial(longest_bodies, settings=admission.settings),
        admission.site.frame_ancestors,
    )
    for routes in _ROUTES:
        app.include_router(routes.router)
    app.add_middleware(HeadRequests)
    app.add_middleware(
        RequestContext,
        admission=admission,
        metrics=metrics,
        open_paths=(*public.PATHS, *page.PATHS),
        claim=pairing.CLAIM,
        passing=_PASSING,
        body=Body(MAX_BODY),
        sizes=app.state.sizes,
        uploads={
            ("POST", bundles.PREFIX): Body(
                service.upload_limit, (BUNDLE_MEDIA_TYPE,), required=True
            ),
            ("PUT", simulation.PATH): Body(
                simulation.MAX_PICTURE, PICTURE_MEDIA_TYPES, required=True
            ),
        },
    )
    return app
