"""Page of the daemon: what somebody sees who opens its address in a browser."""

from __future__ import annotations

from fastapi import APIRouter
from fastapi.responses import HTMLResponse

from veilcam_server.api.dependencies import open_problems

PATH = "/"
TEXT = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<title>Veilcam</title>
<h1>Veilcam</h1>
<p>This is a camera without a lens. Programs ask it: the command <code>veilcam</code>, or the Python
package <code>veilcam_client</code>.</p>
</html>
"""

router = APIRouter(redirect_slashes=False)


@router.get(PATH, response_class=HTMLResponse, responses=open_problems())
async def page() -> str:
    """What this is, for people; it says nothing of the camera, and wants no token."""
    return TEXT
