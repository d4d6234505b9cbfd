"""The camera for oneself, for a while."""

from __future__ import annotations

from pydantic import Field

from veilcam_client.wire.base import Answer, Question


class LeaseRequest(Question):
    """Hold the camera: for ``seconds``, others take no captures and change no mask."""

    owner: str = Field(min_length=1, max_length=64, pattern=r"^[\x20-\x7e]+$")
    """Name of the holder, for those who are turned away."""
    seconds: float = Field(gt=0, le=3600)
    """Length of the lease, from now on [s]."""


class Lease(Answer):
    """Lease of the camera, if there is one."""

    held: bool
    """True: somebody holds the camera."""
    owner: str | None
    """Name that the holder gave."""
    expires_in_s: float | None
    """Time until it ends by itself [s]."""
    mine: bool
    """True: the caller is the holder."""


class NewLease(Lease):
    """A lease just taken or renewed."""

    secret: str | None = Field(default=None, repr=False)
    """Value of ``Veilcam-Lease`` in every request of the holder, where no tokens are wanted."""


def _lease() -> Lease:
    return Lease(held=True, owner="an experiment", expires_in_s=58.5, mine=True)


def examples() -> tuple[Answer | Question, ...]:
    """Return examples for documents."""
    return (
        LeaseRequest(owner="an experiment", seconds=60.0),
        _lease(),
        NewLease(**_lease().model_dump(), secret=None),
    )
