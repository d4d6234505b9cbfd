"""Fixtures of the server's unit tests, for tests that start a daemon or a process."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import httpx
from tests.unit.server.conftest import *  # noqa: F403
from tests.unit.server.conftest import _no_settings_from_outside, _one_plan_for_all, _own_logs

from veilcam_server.api.app import create_app
from veilcam_server.security.admission import Admission
from veilcam_server.service.service import Service

__all__ = ["_no_settings_from_outside", "_one_plan_for_all", "_own_logs"]


@asynccontextmanager
async def asking(service: Service) -> AsyncIterator[httpx.AsyncClient]:
    """Open a service and ask it in process."""
    transport = httpx.ASGITransport(create_app(service, Admission()))
    async with (
        service.open(),
        httpx.AsyncClient(transport=transport, base_url="http://localhost") as http,
    ):
        yield http
