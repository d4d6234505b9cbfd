"""Event stream that broke: when it is opened again, and after which event it goes on."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from datetime import UTC, datetime

from veilcam_client.arguments import of_type
from veilcam_client.errors import ArgumentError, RequestTimeoutError, VeilcamError
from veilcam_client.http.options import STREAM_SILENCE, Options, log
from veilcam_client.wire.events import Believed, Event, Gap, Gone, Seen
from veilcam_client.wire.watch import Sighting

LONGEST_PAUSE = 30.0
"""Before a stream is opened again [s]."""
HEALTHY = 30.0
"""A stream that was alive for so long begins with short pauses anew [s]."""
_PASSING = frozenset((502, 503, 504))
"""Statuses of a proxy whose daemon is about to come back."""


def check_stream(last_event_id: str | None, reconnect: bool) -> None:
    """Raise ArgumentError for arguments of a stream that cannot be used."""
    of_type("reconnect", reconnect, bool, "True or False")
    if last_event_id is not None:
        of_type("last_event_id", last_event_id, str, "the id of an event")
        if not (last_event_id.isascii() and last_event_id.isprintable()):
            raise ArgumentError("last_event_id is not valid: use the id of an event")


class Resumption:
    """One event stream, over all its connections.

    While the daemon has not answered yet it is tried as often as any request; after that, until
    somebody closes the stream, or not at all unless ``reconnect``.
    """

    def __init__(self, options: Options, last_event_id: str | None, reconnect: bool) -> None:
        self._options, self._last, self._reconnect = options, last_event_id, reconnect
        self._failed = 0
        self._answered = False
        self._believed = False
        self._there: Sighting | None = None
        self._opened: float | None = None
        """Start of the present connection, None where there is none."""

    def headers(self) -> dict[str, str]:
        """Headers of the next request."""
        headers = {"Accept": "text/event-stream"}
        if self._last is not None:
            headers["Last-Event-ID"] = self._last
        return self._options.headers(headers)

    def opened(self) -> Iterator[Gap]:
        """Note that the daemon streams; yield what the daemon cannot know that was missed."""
        again, self._answered, self._opened = self._answered, True, time.monotonic()
        if again and self._last is None:
            yield Gap(id="", at=datetime.now(UTC))

    def heard(self, event: Event) -> Iterator[Event]:
        """Note an event, after which the stream goes on; yield what it tells of."""
        if event.id:
            self._last = event.id
        if not isinstance(event, Believed):
            yield event
            return
        before, now, first = self._there, event.sighting, not self._believed
        self._there, self._believed = now, True
        if first or _stays(before, now):
            return
        if before is not None:
            # In tenths, it is sure: an object counts as gone from .95 on.
            sure = None if before.confidence is None or event.belief is None else 1.0
            yield Gone(
                id="",
                at=event.at,
                label=before.label,
                confidence=sure,
                duration_s=before.duration_s,
                reason="not_looking" if event.belief is None else "left",
            )
        if now is not None:
            yield Seen(
                id="",
                at=event.at,
                label=now.label,
                confidence=now.confidence,
                duration_s=now.duration_s,
            )

    def pause(self, error: VeilcamError) -> float:
        """Seconds to wait before the next connection, or raise what no waiting puts right."""
        retry = self._options.retry
        if self._alive(error) >= HEALTHY:
            self._failed = 0
        self._opened = None
        attempt, self._failed = self._failed, self._failed + 1
        if not self._answered:
            delay = retry.delay(attempt, error)
        elif self._reconnect and (error.retryable or error.status in _PASSING):
            asked = min(error.retry_after or 0.0, retry.patience)
            longest = min(LONGEST_PAUSE, math.ldexp(retry.base, min(attempt, 30)))
            # Half of it is certain: chance alone would let a grown pause be short again.
            delay = asked + retry.uniform(longest / 2, longest)
        else:
            raise error
        log.info("event stream ended with %r, once more in %.2f s", error.code, delay)
        return delay

    def _alive(self, error: VeilcamError) -> float:
        """Seconds for which the connection that ended was alive."""
        if self._opened is None:
            return 0.0
        silent = STREAM_SILENCE if isinstance(error, RequestTimeoutError) else 0.0
        return time.monotonic() - self._opened - silent


def _stays(before: Sighting | None, now: Sighting | None) -> bool:
    """Return whether nothing came or went between two states."""
    if before is None or now is None:
        return before is now
    return before.label == now.label and before.duration_s <= now.duration_s
