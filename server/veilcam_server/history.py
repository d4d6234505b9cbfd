"""What happened since the start: counted, and the last states and faults."""

from __future__ import annotations

from collections import Counter, deque
from datetime import UTC, datetime

from veilcam_client.wire.captures import State
from veilcam_client.wire.diagnostics import PastFault, PastState
from veilcam_client.wire.events import Event, Fault, StateChanged

LENGTH = 32
"""States and faults that are remembered."""


class History:
    """Takes note of every event."""

    def __init__(self) -> None:
        self.events: Counter[str] = Counter()
        """Events by kind."""
        self.faults: Counter[str] = Counter()
        """Faults by code."""
        self.last_states: deque[PastState] = deque(maxlen=LENGTH)
        self.last_faults: deque[PastFault] = deque(maxlen=LENGTH)

    def begin(self, state: State, detail: str | None) -> None:
        """Take note of the state in which the daemon begins, which no event tells of."""
        self.last_states.append(PastState(at=datetime.now(UTC), state=state, detail=detail))

    def add(self, event: Event) -> None:
        """Take note of one event."""
        self.events[event.kind] += 1
        if isinstance(event, Fault):
            self.faults[event.code] += 1
            self.last_faults.append(PastFault(at=event.at, code=event.code, detail=event.detail))
        elif isinstance(event, StateChanged):
            self.last_states.append(PastState(at=event.at, state=event.state, detail=event.detail))
