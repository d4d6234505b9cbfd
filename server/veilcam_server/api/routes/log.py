"""REST API of the log: signed records of what left, and of who changed it."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Query

from veilcam_client.wire.log import RECORDS_AT_ONCE, LogRecords
from veilcam_server.api.dependencies import ServiceDep, problems, requires

router = APIRouter(prefix="/v1/log", redirect_slashes=False, tags=["Log"])


@router.get(
    "",
    dependencies=[requires("read:log")],
    responses=problems("invalid_request", "storage_failed"),
)
async def log(
    service: ServiceDep,
    after: Annotated[int | None, Query(ge=0, lt=2**63)] = None,
    limit: Annotated[int, Query(ge=1, le=RECORDS_AT_ONCE)] = RECORDS_AT_ONCE,
    *,
    newest: Annotated[bool, Query()] = False,
) -> LogRecords:
    """Return the oldest records, or the newest; all of them are on the disk."""
    return await asyncio.to_thread(service.log.records, after, limit, newest=newest)
