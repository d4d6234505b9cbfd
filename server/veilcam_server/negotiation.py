"""Which media type a client wants (RFC 9110, section 12.5.1)."""

from __future__ import annotations

from collections.abc import Sequence


def preferred(accept: str, offers: Sequence[str]) -> str | None:
    """Return the offer with the highest quality, the first of equals, or None if none will do.

    Args:
        accept: the Accept header, e.g. ``application/x-npy, application/json;q=0.5``.
        offers: media types in order of the server's own preference.
    """
    ranges = [_parse(item) for item in accept.split(",")]
    best, best_quality = None, 0.0
    for offer in offers:
        # The most specific range decides, whatever its quality.
        matches = [
            (specific, quality)
            for pattern, quality in ranges
            if (specific := _match(pattern, offer))
        ]
        quality = max(matches, default=(0, 0.0))[1]
        if quality > best_quality:
            best, best_quality = offer, quality
    return best


def _parse(item: str) -> tuple[str, float]:
    media_type, *parameters = (part.strip().lower() for part in item.split(";"))
    for parameter in parameters:
        if parameter.startswith("q="):
            try:
                return media_type, min(1.0, max(0.0, float(parameter[2:])))
            except ValueError:
                return media_type, 0.0
    return media_type, 1.0


def _match(pattern: str, offer: str) -> int:
    """3 for the type itself, 2 for its family, 1 for anything, 0 for no match."""
    if pattern == offer:
        return 3
    if pattern == f"{offer.partition('/')[0]}/*":
        return 2
    return 1 if pattern == "*/*" else 0
