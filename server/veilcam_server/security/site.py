"""Site of a daemon: its host names, the pages that may ask it, and headers for browsers."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Mapping
from dataclasses import dataclass

from starlette.datastructures import Headers

from veilcam_client.wire.base import CALL_HEADER
from veilcam_server.errors import ProblemError

PAGES = frozenset(("/", "/docs"))
"""Paths that a link on any page may lead to: what is there is for people, and does nothing."""

_PLACE = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+)(?::\d{1,5})?")
"""Host and perhaps port, in small letters."""
_DEFAULT_PORTS = {"http": 80, "https": 443}


@dataclass(frozen=True, slots=True)
class Site:
    """Names of a daemon, and the pages that may show it.

    Attributes:
        hosts: names besides localhost, each with its port where that is no default.
        addresses: True where every IP address names this daemon; else loopback's alone do.
        frame_ancestors: origins of the pages that may show a page of this daemon in a frame.
        root_path: path under which a proxy shows this daemon; empty: at its root.
    """

    hosts: tuple[str, ...] = ()
    addresses: bool = False
    frame_ancestors: tuple[str, ...] = ()
    root_path: str = ""

    def below_root(self, path: str) -> str | None:
        """Return a path without the root path, if it has it; None for the root path itself."""
        if not self.root_path or not f"{path}/".startswith(f"{self.root_path}/"):
            return path
        return path.removeprefix(self.root_path) or None

    def require(self, method: str, path: str, headers: Headers) -> None:
        """Refuse what a page of another site makes a browser ask.

        Raises:
            ProblemError: for another host, or from a page of another site.
        """
        # A page in a browser can make its own name resolve to this machine (DNS rebinding);
        # the Host header then betrays it. An address cannot be made to lead elsewhere.
        host = headers.get("host", "").lower()
        if not self._serves(host):
            raise ProblemError(
                "host_refused",
                "this daemon has no such name: use localhost, or start it with --hosts NAME",
            )
        # A browser sends what a page of another site tells it to, also where it keeps the answer
        # from that page. It names the page itself; what is no browser names none.
        if not all(self._is_own(origin.lower(), host) for origin in headers.getlist("origin")):
            raise _cross_site()
        sites = headers.getlist("sec-fetch-site")
        if all(site in ("same-origin", "none") for site in sites):
            return
        if method != "GET" or path not in PAGES or not self._navigates(headers):
            raise _cross_site()

    def _serves(self, host: str) -> bool:
        match = _PLACE.fullmatch(host)
        if match is None:
            return False
        name = match[1]
        if name == "localhost" or any(name == _name(known) for known in self.hosts):
            return True
        try:
            address = ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return address.is_loopback or self.addresses

    def _is_own(self, origin: str, host: str) -> bool:
        """Return whether an ``Origin`` is the host and port of ``Host``, or a name that was given.

        ``null`` has none. A proxy in front of the daemon may ask it under another ``Host``.
        """
        return any(_is_of(origin, place) for place in (host, *self.hosts))

    def _navigates(self, headers: Headers) -> bool:
        """Return whether a browser opens a page, in a tab or in a frame that may show it."""
        shown = ("document", "iframe") if self.frame_ancestors else ("document",)
        return (
            headers.getlist("sec-fetch-mode") == ["navigate"]
            and headers.get("sec-fetch-dest") in shown
        )


def _name(place: str) -> str:
    return re.sub(r":\d+$", "", place)


def _is_of(origin: str, place: str) -> bool:
    """Return whether ``origin`` has this host and port.

    A port left out is the default of the origin's scheme, which may be another than ours: a proxy
    in front of the daemon may speak TLS.
    """
    scheme, _, host = origin.partition("://")
    port = _DEFAULT_PORTS.get(scheme)
    return port is not None and _with_port(host, port) == _with_port(place, port)


def _with_port(place: str, port: int) -> str:
    return place if re.search(r":\d+$", place) else f"{place}:{port}"


def _cross_site() -> ProblemError:
    return ProblemError(
        "cross_site", "this daemon answers to no page of another site: ask without a browser"
    )


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
