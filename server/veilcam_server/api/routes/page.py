"""Page for people, and the API as a page: files that everybody may have, and that say nothing.

What they show they ask for, as any other caller does.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fastapi import APIRouter
from fastapi.responses import HTMLResponse, Response

from veilcam_server.api.conditional import KNOWN, IfNoneMatch, has
from veilcam_server.api.dependencies import AdmissionDep, open_problems
from veilcam_server.errors import ProblemError
from veilcam_server.security.site import content_security_policy

FOLDER = Path(__file__).parents[1] / "page"
ASSETS = "/page"
"""Path under which the files lie that the two pages are made of."""
_MEDIA_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".png": "image/png",
    ".svg": "image/svg+xml",
}
_SOURCES = (
    *("script-src 'self'", "style-src 'self'", "img-src 'self' data:", "connect-src 'self'"),
    # No text becomes a script, whatever a page might do with it.
    *("require-trusted-types-for 'script'", "trusted-types 'none'"),
)
"""What the two pages may load: from this daemon alone, and nothing that stands in them."""


@dataclass(frozen=True, slots=True)
class _File:
    content: bytes
    media_type: str
    tag: str


def _read(path: Path) -> _File:
    content = path.read_bytes()
    tag = hashlib.sha256(content).hexdigest()[:32]
    return _File(content, _MEDIA_TYPES[path.suffix], tag)


# All of them, from the beginning: no path that is asked for ever becomes a path of the disk.
_FILES: Mapping[str, _File] = {
    path.name: _read(path) for path in sorted(FOLDER.iterdir()) if path.suffix in _MEDIA_TYPES
}
PATHS = ("/", "/docs", *(f"{ASSETS}/{name}" for name in _FILES))

_PAGE: dict[int | str, dict[str, Any]] = {
    200: {"content": {"text/html": {"schema": {"type": "string"}, "example": "<!DOCTYPE html>"}}},
    **KNOWN,
    **open_problems("invalid_request"),
}
_ASSET: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {
            "text/css": {"schema": {"type": "string"}, "example": "body { margin: 0 auto; }"},
            "text/javascript": {"schema": {"type": "string"}, "example": "export {};"},
            "image/png": {"schema": {"type": "string", "format": "binary"}},
        }
    },
    **KNOWN,
    # A name that there is not is like any other path: nobody is told without a token.
    **open_problems(
        "invalid_request", "not_found", "unauthorized", "too_many_requests", "storage_failed"
    ),
}

router = APIRouter(redirect_slashes=False, tags=["Pages"])


@router.get("/", response_class=HTMLResponse, responses=_PAGE)
async def page(admission: AdmissionDep, if_none_match: IfNoneMatch = "") -> Response:
    """Page of the camera, in a browser; it asks for a token, and shows nothing without one."""
    return _document("index.html", admission.site.frame_ancestors, if_none_match)


@router.get("/docs", response_class=HTMLResponse, responses=_PAGE)
async def docs(admission: AdmissionDep, if_none_match: IfNoneMatch = "") -> Response:
    """Return this document for people, in a browser."""
    return _document("docs.html", admission.site.frame_ancestors, if_none_match)


@router.get(ASSETS + "/{name}", response_class=Response, responses=_ASSET)
async def page_file(name: str, if_none_match: IfNoneMatch = "") -> Response:
    """File of the two pages: script, style or picture."""
    if name not in _FILES:
        raise ProblemError("not_found", "the pages have no such file")
    return _answer(_FILES[name], if_none_match)


def _document(name: str, frame_ancestors: tuple[str, ...], if_none_match: str) -> Response:
    answer = _answer(_FILES[name], if_none_match)
    answer.headers["Content-Security-Policy"] = content_security_policy(frame_ancestors, *_SOURCES)
    return answer


def _answer(file: _File, if_none_match: str) -> Response:
    headers = {"ETag": f'"{file.tag}"', "Cache-Control": "private, no-cache"}
    if has(if_none_match, file.tag):
        return Response(status_code=304, headers=headers)
    return Response(file.content, headers=headers, media_type=file.media_type)
