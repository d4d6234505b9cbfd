"""REST API of the capture log: signed records of what was answered, and where they end."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Query

from veilcam_client.wire.log import RECORDS_AT_ONCE, LogHead, LogRecords
from veilcam_server.api.dependencies import ServiceDep, problems
from veilcam_server.api.scopes import requires

_REFUSALS = ("invalid_request", "not_enabled", "storage_failed")

router = APIRouter(prefix="/v1/log", redirect_slashes=False, tags=["Log"])


@router.get("", dependencies=[requires("read:log")], responses=problems(*_REFUSALS))
async def log(
    service: ServiceDep,
    after: Annotated[int | None, Query(ge=0, lt=2**63)] = None,
    limit: Annotated[int, Query(ge=1, le=RECORDS_AT_ONCE)] = RECORDS_AT_ONCE,
) -> LogRecords:
    """Return records of answers, the oldest first; all of them are on the disk."""
    return await asyncio.to_thread(service.capture_log.records, after, limit)


@router.get("/head", dependencies=[requires("read:log")], responses=problems(*_REFUSALS))
async def log_head(service: ServiceDep) -> LogHead:
    """Signed head of the log; all records up to it are on the disk."""
    return await asyncio.to_thread(service.capture_log.head)
