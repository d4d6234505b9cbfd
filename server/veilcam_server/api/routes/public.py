"""Routes that want no token: a page for people, and what a monitor asks every few seconds."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from fastapi.responses import HTMLResponse, PlainTextResponse

from veilcam_server.api.dependencies import ServiceDep, open_problems

PATHS = ("/", "/healthz", "/readyz")
PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<title>Veilcam</title>
<h1>Veilcam</h1>
<p>This is a camera without a lens. Programs ask it: the command <code>veilcam</code>, or the Python
package <code>veilcam_client</code>.</p>
</html>
"""
_WELL = ("ready", "self-test", "replay")
"""States in which a capture is taken, if need be after a self test."""


def _word(word: str) -> dict[str, Any]:
    return {
        "description": word,
        "content": {"text/plain": {"schema": {"const": word}, "example": word}},
    }


_PAGE: dict[int | str, dict[str, Any]] = {
    200: {"content": {"text/html": {"example": PAGE}}},
    **open_problems(),
}
_WORDS: dict[int | str, dict[str, Any]] = {200: _word("yes"), 503: _word("no"), **open_problems()}

router = APIRouter(redirect_slashes=False)


@router.get("/", response_class=HTMLResponse, responses=_PAGE)
async def page() -> str:
    """What this is, for people; it says nothing of the camera."""
    return PAGE


@router.get("/healthz", response_class=PlainTextResponse, responses=_WORDS)
async def healthz(service: ServiceDep) -> PlainTextResponse:
    """Whether panel and camera still answer; systemd's watchdog is fed as long as they do."""
    return _answer(service.healthy())


@router.get("/readyz", response_class=PlainTextResponse, responses=_WORDS)
async def readyz(service: ServiceDep) -> PlainTextResponse:
    """Whether a capture would be taken now."""
    return _answer(service.status().state in _WELL)


def _answer(yes: bool) -> PlainTextResponse:
    return PlainTextResponse("yes" if yes else "no", 200 if yes else 503)
