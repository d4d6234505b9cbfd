"""Headers of every answer: those for browsers, and the name of the request."""

from __future__ import annotations

import re
from collections.abc import Mapping

from starlette.datastructures import Headers

from veilcam_client.wire.base import CALL_HEADER

_CALL = re.compile(r"[0-9A-Fa-f]{32}")


def security_headers(frame_ancestors: tuple[str, ...]) -> Mapping[str, str]:
    """Return the headers that tell a browser to make nothing of an answer, refusals included.

    Args:
        frame_ancestors: origins of the pages that may show it in a frame.
    """
    return {
        "Content-Security-Policy": content_security_policy(frame_ancestors),
        "Cross-Origin-Resource-Policy": "same-origin",
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
    }


def content_security_policy(frame_ancestors: tuple[str, ...], *sources: str) -> str:
    """Return a policy that allows nothing but ``sources``.

    Args:
        frame_ancestors: origins of the pages that may show it in a frame.
        sources: further directives.
    """
    framing = " ".join(frame_ancestors) or "'none'"
    return "; ".join(
        (
            *("default-src 'none'", *sources, "base-uri 'none'", "form-action 'none'"),
            f"frame-ancestors {framing}",
        )
    )


def call_header(request: Headers) -> Mapping[str, str]:
    """Return the header that names a request in its answer; empty if the request has no valid one.

    Args:
        request: headers of the request.
    """
    given = request.getlist(CALL_HEADER)
    valid = len(given) == 1 and _CALL.fullmatch(given[0])
    return {CALL_HEADER: given[0]} if valid else {}
