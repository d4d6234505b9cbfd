"""Watch of a camera that looks by itself: its policy and its belief.

``GET /v1/watch`` answers with :class:`Watch`, and ``PUT /v1/watch`` takes a :data:`WatchPolicy`.
"""

from __future__ import annotations

import re
from datetime import datetime, time
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, TypeAdapter, model_validator

from veilcam_client.wire.base import EXAMPLE_TIME, Answer, Question
from veilcam_client.wire.status import EXAMPLE_CLOCK, WallClock

SLOWEST, FASTEST = 1 / 3600, 10.0
"""Looks in a second, at least and at most."""
_RATE = re.compile(r"([0-9]{1,4}(?:\.[0-9]{1,3})?)/(s|min|h)")
_SECONDS = {"s": 1, "min": 60, "h": 3600}
_HOUR = "([01]?[0-9]|2[0-3])(?::([0-5][0-9]))?"
_HOURS = re.compile(f"{_HOUR}-{_HOUR}")
TIME_OF_DAY = r"^([01][0-9]|2[0-3]):[0-5][0-9]$"


class QuietHours(Question):
    """Part of a day, from one time to another, by the wall clock of the camera.

    Over midnight where the end comes first. The end itself is not among them.
    """

    begin: str = Field(pattern=TIME_OF_DAY)
    """First minute, HH:MM."""
    end: str = Field(pattern=TIME_OF_DAY)
    """Minute after the last, HH:MM."""

    @model_validator(mode="after")
    def _check_length(self) -> QuietHours:
        if self.begin == self.end:
            raise ValueError("hours begin and end at two times of day")
        return self

    def include(self, now: time) -> bool:
        """Return whether a time of day is among them."""
        begin, end = time.fromisoformat(self.begin), time.fromisoformat(self.end)
        if begin < end:
            return begin <= now < end
        return now >= begin or now < end


class WatchOff(Question):
    """It does not look: the panel is opaque, and nobody takes a capture."""

    mode: Literal["off"] = "off"
    """Kind of the policy."""


class OnRequest(Question):
    """It looks when somebody asks it to."""

    mode: Literal["on_request"] = "on_request"
    """Kind of the policy."""
    quiet: QuietHours | None = None
    """Hours when the panel is opaque, and nobody takes a capture."""


class Watching(Question):
    """It looks by itself, and when somebody asks."""

    mode: Literal["watching"] = "watching"
    """Kind of the policy."""
    rate_hz: float = Field(ge=SLOWEST, le=FASTEST)
    """Rate of looks [1/s], where nothing else keeps the camera busy."""
    quiet: QuietHours | None = None
    """Hours, as of :class:`OnRequest`."""


WatchPolicy = Annotated[WatchOff | OnRequest | Watching, Field(discriminator="mode")]

WATCH_POLICY: TypeAdapter[WatchPolicy] = TypeAdapter(
    WatchPolicy, config=ConfigDict(defer_build=True)
)


def parse_rate(text: str) -> float:
    """Read ``2/s``, ``30/min`` or ``6/h``, as looks in a second; raises ValueError."""
    found = _RATE.fullmatch(text)
    rate = float(found[1]) / _SECONDS[found[2]] if found else 0.0
    # A little less than once in an hour is a rounding error of 1/h.
    if not SLOWEST * (1 - 1e-9) <= rate <= FASTEST:
        raise ValueError(f"{text!r} is no rate: use 2/s, 30/min or 6/h, from 1/h to {FASTEST:g}/s")
    return max(rate, SLOWEST)


def parse_hours(text: str) -> QuietHours:
    """Read ``22-7`` or ``22:30-07:00``; raises ValueError."""
    found = _HOURS.fullmatch(text)
    if not found:
        raise ValueError(f"{text!r} are no hours: use 22-7, or 22:30-07:00")
    begin, end = (f"{int(found[n]):02}:{found[n + 1] or '00'}" for n in (1, 3))
    if begin == end:
        raise ValueError(f"{text!r} is no time at all: switch the camera off instead")
    return QuietHours(begin=begin, end=end)


Activity = Literal["looking", "on_request", "off", "quiet", "leased", "waiting"]
"""What it does: ``looking`` by itself; ``on_request`` alone; ``off`` and ``quiet``: the panel is
opaque, by the policy and by its hours; ``leased``: it waits for the end of a lease; ``waiting``:
for the camera, which is busy or not ready."""


class Belief(Answer):
    """Belief about the scene, by all captures so far."""

    label: str | None
    """None: nothing that it knows."""
    confidence: float | None = None
    """Probability of that, in [0, 1]; as of :class:`Classification`."""
    since: datetime
    """Start of that belief."""
    duration_s: float
    """Time since then [s]."""
    looks: int
    """Number of its own captures that tell that."""


class Sighting(Answer):
    """Something that was seen."""

    label: str
    """Label of the object."""
    confidence: float | None = None
    """The highest while it was there, in [0, 1]; as of :class:`Belief`."""
    seen_at: datetime
    """Time of the first capture that told of it."""
    gone_at: datetime | None
    """None: it is there still."""
    duration_s: float
    """Time until it went, or until now [s]."""


MOST_SIGHTINGS = 64
"""That are remembered, in memory alone: the oldest is forgotten, and all are with a restart."""


class Watch(Answer):
    """Policy of the watch, and the belief."""

    policy: WatchPolicy
    """Policy of the watch."""
    activity: Activity
    """Present activity."""
    detail: str | None = None
    """Why it does not look."""
    looks: int
    """Captures of its own since the start; 0 without the scope ``classify``."""
    belief: Belief | None = None
    """None while it does not look, and without the scope ``classify``."""
    history: tuple[Sighting, ...] = ()
    """The last ones, newest first; empty without the scope ``classify``."""
    clock: WallClock | None = None
    """By which quiet hours go; None: an older daemon's."""


def _watching() -> Watching:
    return Watching(rate_hz=2.0, quiet=QuietHours(begin="22:00", end="07:00"))


def examples() -> tuple[Answer | Question, ...]:
    """Return examples for documents."""
    return (
        WatchOff(),
        OnRequest(),
        _watching(),
        Watch(
            policy=_watching(),
            activity="looking",
            looks=7200,
            belief=Belief(
                label="3", confidence=0.998, since=EXAMPLE_TIME, duration_s=12.5, looks=25
            ),
            history=(
                Sighting(
                    label="3",
                    confidence=0.998,
                    seen_at=EXAMPLE_TIME,
                    gone_at=None,
                    duration_s=12.5,
                ),
            ),
            clock=EXAMPLE_CLOCK,
        ),
    )
