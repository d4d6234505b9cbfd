"""The active mask, captures behind it, and the fence around each of them."""

from __future__ import annotations

import math
import secrets
from dataclasses import dataclass, field
from datetime import datetime
from typing import Protocol

import numpy as np

from veilcam_client.wire.captures import (
    Embedding,
    Notes,
    Prediction,
    Replay,
    SealedEmbedding,
    Timing,
)
from veilcam_client.wire.captures import Exposure as ExposureNote
from veilcam_client.wire.rotation import EveryCaptures, EverySeconds, RotationOff, RotationPolicy
from veilcam_client.wire.sealing import Form
from veilcam_server.camera.epochs import Epoch
from veilcam_server.devices.base import Exposure, Measurement
from veilcam_server.errors import FenceError
from veilcam_server.masks.source import Evidence, Reader


@dataclass(frozen=True, slots=True)
class Fence:
    """Fence that keeps a measurement from mixing two masks."""

    settle: float = 0.1
    """Given to the panel after a write; measured once per panel, 100 ms to start from [s]."""
    timeout: float = 5.0
    """Longest wait for one measurement [s]."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.settle) and self.settle >= 0):
            raise ValueError(f"settle = {self.settle} s is not valid: use a number >= 0")
        if not (math.isfinite(self.timeout) and self.timeout > 0):
            raise ValueError(f"timeout = {self.timeout} s is not valid: use a number > 0")


def check_exposure(
    exposure: Exposure, *, not_before: float, ended: float, shape: tuple[int, ...]
) -> None:
    """Refuse a measurement that cannot be trusted.

    Args:
        exposure: exposure as the sensor gave it.
        not_before: time when the mask had settled, monotonic [s].
        ended: time when the sensor returned.
        shape: shape of an embedding.

    Raises:
        FenceError: exposed before or after that, of another shape, or not finite.
    """
    if not not_before <= exposure.started_at <= exposure.ended_at <= ended:
        raise FenceError(
            f"the exposure began {exposure.started_at - not_before:+.4f} s after the mask had "
            "settled and was thrown away: try again"
        )
    if exposure.embedding.shape != shape:
        raise FenceError(
            f"the sensor gave a measurement of shape {exposure.embedding.shape}, not {shape}: "
            "check that the bundle fits this device"
        )
    if not bool(np.isfinite(exposure.embedding).all()):
        raise FenceError("the sensor gave a measurement that is not finite: try again")


def due_in(policy: RotationPolicy, *, shown_for: float, captures: int, chance: float) -> float:
    """Return how long the present mask may stay [s]: 0 when it must change, inf for ever.

    Args:
        policy: policy that was asked for.
        shown_for: time that the mask has been on the panel [s].
        captures: number of captures under it.
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


_RANDOM = secrets.SystemRandom()


@dataclass(eq=False, slots=True)
class ActiveMask:
    """The epoch on the panel; it and its times belong together and are replaced together."""

    epoch: Epoch
    since: float
    """When it was first shown, monotonic [s]."""
    completed_at: float
    """When it was last written; later than ``since`` when it was put back after a failure."""
    chance: float = field(default_factory=_RANDOM.random)
    """How much of a policy's jitter it gets."""
    captures: int = 0
    """Exposures that were begun behind it, whatever came of them."""
    overdue: int = 0
    """Captures taken while it was due and the next was not ready."""
    late: bool = False
    """Whether a capture was due before the next mask was ready."""

    def reuse(self, limit: int, lateness: Lateness) -> bool:
        """Return whether it may serve one more capture although it is due; that is counted.

        Args:
            limit: greatest number of such captures.
            lateness: count of such captures, too.
        """
        if not self.late:
            self.late = True
            lateness.late += 1
        if self.overdue >= limit:
            return False
        self.overdue += 1
        lateness.reused += 1
        return True


@dataclass(frozen=True, slots=True)
class Frame:
    """Exposure under a mask, before the guard vouched for it."""

    exposure: Exposure = field(repr=False)
    active: ActiveMask
    number: int
    """Number of the exposure in its epoch, from 0 on."""
    taken_at: datetime
    """UTC, to the second."""
    rotation_s: float
    settle_s: float
    capture_s: float


@dataclass(frozen=True, slots=True)
class Provenance:
    """Entry of the log beside an answer."""

    mask: str
    """Commitment to the mask that it names, 64 hexadecimal digits."""
    tested: float
    """How long before the panel passed its self-test [s]."""
    calibration: str | None
    """Digest of the calibration in force; None: the camera was taken to be nominal."""


class Captured(Protocol):
    """One measurement, which says no more than its label and leaves in its form."""

    @property
    def epoch(self) -> str:
        """Name of the epoch."""

    @property
    def number(self) -> int:
        """Number of the capture in its epoch, from 0 on; none comes twice."""

    @property
    def taken_at(self) -> datetime:
        """UTC, to the second."""

    @property
    def form(self) -> Form | None:
        """In which its embedding leaves; None: it stays."""

    @property
    def replay(self) -> Replay | None:
        """Recording that it comes from: nothing was exposed."""

    @property
    def provenance(self) -> Provenance | None:
        """Entry of the log; None: a recording is not logged as if it were a capture."""

    def classify(self) -> Prediction:
        """Return the label, as the reader of its own mask tells it."""

    def evidence(self) -> Evidence:
        """Return what it tells beside its label, for who fuses several captures."""

    def release(self, queue_s: float) -> Embedding | SealedEmbedding:
        """Return the embedding as it leaves; once, and in the order of the captures.

        Args:
            queue_s: time that the request waited for the device [s].
        """

    def done(self) -> None:
        """Let go of the epoch, whatever came of it; twice does no harm."""


@dataclass(eq=False, slots=True)
class MaskedCapture:
    """A capture of this camera. It holds its epoch until it is done.

    ``release`` raises ValueError where nothing was to leave.
    """

    frame: Frame
    provenance: Provenance
    exposure: ExposureNote
    scene: int | None
    """Number of what a simulated camera looked at."""
    form: Form | None = None
    replay: None = field(default=None, init=False)
    _done: bool = field(default=False, init=False, repr=False)

    @property
    def measurement(self) -> Measurement:
        """Embedding as the sensor gave it."""
        return self.frame.exposure.embedding

    @property
    def active(self) -> Epoch:
        """Epoch of the mask that was shown."""
        return self.frame.active.epoch

    @property
    def number(self) -> int:
        """Number of the capture in its epoch."""
        return self.frame.number

    @property
    def taken_at(self) -> datetime:
        """UTC, to the second."""
        return self.frame.taken_at

    @property
    def epoch(self) -> str:
        """Name of the epoch."""
        return self.active.name

    @property
    def reader(self) -> Reader:
        """Epoch of the mask that was shown."""
        return self.active.mask.reader

    def classify(self) -> Prediction:
        """Return the label."""
        return self.reader.classify(self.measurement)

    def evidence(self) -> Evidence:
        """Return what it tells beside its label."""
        return self.reader.evidence(self.measurement)

    def release(self, queue_s: float) -> Embedding | SealedEmbedding:
        """Return the embedding in its form."""
        if self.form == "raw":
            return Embedding.from_array(self.measurement)
        sealer = self.active.sealer
        if self.form is None or sealer is None:
            raise ValueError("nothing was to leave of this capture")
        timing = Timing(
            queue_s=queue_s,
            rotation_s=self.frame.rotation_s,
            settle_s=self.frame.settle_s,
            capture_s=self.frame.capture_s,
        )
        notes = Notes(
            exposure=self.exposure,
            timing=timing,
            scene=self.scene,
        )
        return sealer.seal(self.number, self.taken_at, self.measurement, notes)

    def done(self) -> None:
        """Let go of the epoch; twice does no harm."""
        if not self._done:
            self._done = True
            self.active.let_go()


@dataclass(slots=True)
class Lateness:
    """Outcome where the next mask was not ready."""

    late: int = 0
    """Masks that a capture found due before the next one was ready."""
    reused: int = 0
    """Captures taken under a mask that was due."""
