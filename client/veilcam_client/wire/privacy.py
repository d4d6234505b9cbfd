"""The wire contract of privacy: what somebody can learn from a camera as it is set up."""

from __future__ import annotations

from veilcam_client.wire.base import Answer


class Observer(Answer):
    """Somebody who may learn something from a camera."""

    who: str
    """Access that they have."""
    learns: str
    """Most that they learn, in one sentence."""
    measured: str
    """Figure of the best attack that was tried, in words."""
    switch: str
    """Setting or command that changes it."""


class Privacy(Answer):
    """Everybody who may learn something from this camera, the farthest away first."""

    observers: tuple[Observer, ...]
    """One for each kind of access."""


def examples() -> tuple[Answer, ...]:
    """Return examples for documents."""
    return (
        Privacy(
            observers=(
                Observer(
                    who="has a token that reads the status",
                    learns="When captures are taken, who receives them, and faults.",
                    measured="presence told with an AUC of at most 0.55; 0.5 is a guess",
                    switch="veilcam token revoke",
                ),
            )
        ),
    )
