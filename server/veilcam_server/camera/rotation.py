"""Due times of mask changes."""

from __future__ import annotations

import math

from veilcam_client.wire.rotation import EveryCaptures, EverySeconds, RotationOff, RotationPolicy


def due_in(policy: RotationPolicy, *, shown_for: float, captures: int, chance: float) -> float:
    """Return how long the present mask may stay [s]: 0 when it must change, inf for ever.

    Args:
        policy: what was asked for.
        shown_for: how long the mask has been on the panel [s].
        captures: how many were taken under it.
        chance: drawn for this showing, uniform over [0, 1): how much of the jitter it gets.
    """
    if isinstance(policy, EverySeconds):
        return max(0.0, policy.seconds - chance * policy.jitter - shown_for)
    if isinstance(policy, EveryCaptures):
        return 0.0 if captures >= policy.captures else math.inf
    return math.inf


def reusable(policy: RotationPolicy) -> int:
    """Return how many captures a mask may serve when it is due and the next is not ready."""
    return 0 if isinstance(policy, RotationOff) else policy.reuse
