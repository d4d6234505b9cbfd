"""The address itself, as a person opens it in a browser."""

from __future__ import annotations

from fastapi import APIRouter
from fastapi.responses import HTMLResponse

from veilcam_server.api.dependencies import open_problems
from veilcam_server.api.page import TEXT

PATH = "/"

router = APIRouter(redirect_slashes=False)


@router.get(PATH, response_class=HTMLResponse, responses=open_problems())
async def page() -> str:
    """What this is, for people; it says nothing of the camera, and wants no token."""
    return TEXT
