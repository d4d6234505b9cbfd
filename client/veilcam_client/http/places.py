"""Folders to read from, on this machine or on the web."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx

from veilcam_client.arguments import masked
from veilcam_client.errors import CatalogueError

_PIECE = 2**16
_TIMEOUT_S = 30.0
"""Between two pieces."""


class Place:
    """A folder whose files are read by name; ``name`` has no password."""

    def __init__(self, place: str, client: httpx.Client | None) -> None:
        self.name: str = place.rstrip("/")
        self._client = client

    def __call__(self, name: str, most: int) -> Iterator[bytes]:
        """The pieces of a file; raises CatalogueError where it is longer than ``most`` bytes."""
        left = most
        try:
            for piece in self._pieces(name):
                left -= len(piece)
                if left < 0:
                    raise CatalogueError(f"{name} is longer than {most} bytes: do not use it")
                yield piece
        except (OSError, httpx.HTTPError, httpx.InvalidURL) as error:
            if isinstance(error, httpx.HTTPStatusError):
                why = f"HTTP {error.response.status_code}"
            else:
                why = getattr(error, "strerror", None) or str(error) or type(error).__name__
            raise CatalogueError(f"{self.name}/{name} cannot be read: {why}") from None

    def _pieces(self, name: str) -> Iterator[bytes]:
        if self._client is None:
            with (Path(self.name) / name).open("rb") as stream:
                while piece := stream.read(_PIECE):
                    yield piece
            return
        with self._client.stream("GET", f"{self.name}/{name}") as answer:
            answer.raise_for_status()
            yield from answer.iter_bytes(_PIECE)


@contextmanager
def open_place(place: str) -> Iterator[Place]:
    """What reads files of a folder, or of an http or https address."""
    if not place.lower().startswith(("http://", "https://")):
        yield Place(place, None)
        return
    try:
        url = httpx.URL(place)
    except httpx.InvalidURL:
        raise CatalogueError(f"{masked(place)} is no address: check it") from None
    # Apart from the address, which stands in messages and logs.
    user = (url.username, url.password) if url.userinfo else None
    with httpx.Client(timeout=_TIMEOUT_S, auth=user) as client:
        yield Place(str(url.copy_with(userinfo=b"")), client)
