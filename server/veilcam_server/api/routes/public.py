"""Routes that want no token: what a monitor asks every few seconds."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from fastapi.responses import PlainTextResponse

from veilcam_server.api.dependencies import ServiceDep, open_problems

PATHS = ("/healthz", "/readyz")
_WELL = ("ready", "self-test", "replay")
"""States in which a capture is taken, if need be after a self test."""


def _word(word: str) -> dict[str, Any]:
    return {
        "description": word,
        "content": {"text/plain": {"schema": {"const": word}, "example": word}},
    }


_WORDS: dict[int | str, dict[str, Any]] = {200: _word("yes"), 503: _word("no"), **open_problems()}

router = APIRouter(redirect_slashes=False, tags=["Pages"])


@router.get("/healthz", response_class=PlainTextResponse, responses=_WORDS)
async def healthz(service: ServiceDep) -> PlainTextResponse:
    """Health of panel and camera; systemd's watchdog is fed as long as both answer."""
    return _answer(service.healthy())


@router.get("/readyz", response_class=PlainTextResponse, responses=_WORDS)
async def readyz(service: ServiceDep) -> PlainTextResponse:
    """Readiness for a capture."""
    return _answer(service.status().state in _WELL)


def _answer(yes: bool) -> PlainTextResponse:
    return PlainTextResponse("yes" if yes else "no", 200 if yes else 503)
