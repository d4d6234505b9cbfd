"""Rotation of masks: its policy, and the mask that is shown."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field, TypeAdapter, model_validator

from veilcam_client.wire.base import EXAMPLE_EPOCH, Answer, Question


class RotationOff(Question):
    """The mask stays until it is changed by hand."""

    mode: Literal["off"] = "off"
    """Kind of the policy."""


class EverySeconds(Question):
    """A new mask once the present one has been shown for ``seconds`` [s], or a little less."""

    mode: Literal["seconds"] = "seconds"
    """Kind of the policy."""
    seconds: float = Field(ge=0.1, le=86_400.0)
    """Longest time of a mask on the panel [s]."""
    jitter: float = Field(default=0.0, ge=0.0, le=86_400.0)
    """Each mask stays shorter by a random time of up to this [s], drawn anew for each."""
    reuse: int = Field(default=0, ge=0, le=1_000_000)
    """Captures that a mask may still serve when it is due and the next is not ready; 0 waits."""

    @model_validator(mode="after")
    def _check_jitter(self) -> EverySeconds:
        if self.seconds - self.jitter < 0.1:
            raise ValueError(
                f"jitter {self.jitter:g} s leaves a mask less than 0.1 s of {self.seconds:g} s"
            )
        return self


class EveryCaptures(Question):
    """A new mask once the present one has served ``captures`` captures."""

    mode: Literal["captures"] = "captures"
    """Kind of the policy."""
    captures: int = Field(ge=1, le=1_000_000)
    """Captures under one mask."""
    reuse: int = Field(default=0, ge=0, le=1_000_000)
    """Captures more that a mask may serve when the next one is not ready; 0 waits for it."""


RotationPolicy = Annotated[RotationOff | EverySeconds | EveryCaptures, Field(discriminator="mode")]

POLICY: TypeAdapter[RotationPolicy] = TypeAdapter(
    RotationPolicy, config=ConfigDict(defer_build=True)
)


class Preparation(Answer):
    """Preparation of the next epoch, in the background, so that no capture waits for it."""

    ready: bool
    """True: the next mask is prepared."""
    prepared: int
    """Epochs prepared so far."""
    last_s: float
    """Time that the last one took [s]; 0 before the first."""
    late: int
    """Masks that a capture found due before the next one was ready."""
    reused: int
    """Captures taken under a mask that was due, because the policy allows it."""


class Rotation(Answer):
    """Policy of mask changes, and the present epoch."""

    policy: RotationPolicy
    """Policy of mask changes."""
    epoch: str | None
    """None while no mask is shown."""
    epoch_age_s: float | None = None
    """Time since the mask was shown [s]."""
    captures: int
    """Taken under this epoch so far."""
    preparation: Preparation
    """Preparation of the next mask."""


def example_rotation() -> Rotation:
    """Return a Rotation for documents."""
    return Rotation(
        policy=EveryCaptures(captures=10),
        epoch=EXAMPLE_EPOCH,
        epoch_age_s=12.5,
        captures=3,
        preparation=Preparation(ready=True, prepared=12, last_s=0.03, late=0, reused=0),
    )


def examples() -> tuple[Answer | Question, ...]:
    """Return examples for documents."""
    return (
        RotationOff(),
        EverySeconds(seconds=30.0, jitter=5.0),
        EveryCaptures(captures=10, reuse=2),
        example_rotation(),
    )
