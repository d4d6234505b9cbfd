"""A recording in the place of a camera: the API answers what was recorded, and says so.

There is no panel and no sensor, so nothing is exposed, no mask is shown, and nothing is proven:
what the recording tells of its exposures is handed on as the recording's own word.
"""

from __future__ import annotations

import math
from collections.abc import AsyncIterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from veilcam_client.errors import RecordingError
from veilcam_client.recording import Recorded, Recording, read_recording
from veilcam_client.wire.bundles import Keyring
from veilcam_client.wire.bundles import Keyrings as KeyringsAnswer
from veilcam_client.wire.captures import Device as DeviceInfo
from veilcam_client.wire.captures import Form, Replay, RotationOff, RotationPolicy, State
from veilcam_server.bundles.loader import Identity
from veilcam_server.bundles.manager import Change, Keyrings
from veilcam_server.calibration.service import CalibrationService
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import Captured, Fence
from veilcam_server.camera.epochs import EpochStore, Preparation
from veilcam_server.devices import Device, DisplayError, Exposure, SensorError, Shown
from veilcam_server.devices.base import Levels, Reading
from veilcam_server.errors import ReplayingError, ReplayOverError, StartError
from veilcam_server.masks.classifier import Verdict
from veilcam_server.masks.source import Mask
from veilcam_server.service.service import Service
from veilcam_server.settings import Settings


def replay_service(settings: Settings, path: Path) -> Service:
    """Return a service that answers from a recording.

    Raises:
        StartError: it cannot be read, or another daemon uses the state directory.
    """
    try:
        recording = read_recording(path)
    except RecordingError as error:
        raise StartError(str(error)) from None
    status = recording.header.status
    if status.release == "none":  # no camera released these
        raise StartError(f"{path} was recorded from a camera that releases nothing: record another")
    return Service(
        # Its epochs are never used; holding them keeps a second daemon off.
        ReplayedCamera(recording, Preparation(_NoMasks(), EpochStore(settings.state_dir))),
        Identity(
            DeviceInfo(
                display=f"replay of {status.device.display}",
                sensor=f"replay of {status.device.sensor}",
                simulated=status.device.simulated,
            ),
            status.bundle,
            experiment=status.experiment,
        ),
        _NoKeyrings(),
        CalibrationService(settings, None),
        form=status.release,
        queue_limit=settings.queue_limit,
        heartbeat=settings.heartbeat,
    )


class ReplayedCamera(MaskedCamera):
    """Gives every recorded capture once, in their order. No mask is ever shown.

    Args:
        recording: of a camera.
        preparation: that prepares nothing; closed with this.
    """

    def __init__(self, recording: Recording, preparation: Preparation) -> None:
        shape = recording.header.status.bundle.embedding_shape
        device = Device(_NoPanel(), _NoSensor(), simulated=True)
        super().__init__(device, preparation, shape, _NoTest())
        self._recording, self._place = recording, 0

    @property
    def state(self) -> tuple[State, str | None]:
        """That this is a replay, and how far it is."""
        if super().state[0] == "stopping":
            return super().state
        count, at = len(self._recording.captures), self._recording.header.recorded_at
        return "replay", f"{self._place} of {count} captures recorded on {at:%Y-%m-%d}"

    @property
    def policy(self) -> RotationPolicy:
        """Masks do not change, as there are none."""
        return RotationOff()

    @policy.setter
    def policy(self, policy: RotationPolicy) -> None:
        if not isinstance(policy, RotationOff):
            raise ReplayingError

    @property
    def present(self) -> tuple[str | None, int]:
        """No mask is shown."""
        return None, 0

    def test_due_in(self) -> float:
        """Nothing is tested."""
        return math.inf

    def capture(self) -> Captured:
        """Return the next recorded capture.

        Raises:
            ReplayOverError: there is none left.
        """
        captures = self._recording.captures
        if self._place == len(captures):
            raise ReplayOverError(len(captures))
        place, recorded = self._place, captures[self._place]
        self._place += 1
        capture, exposure = recorded.capture, recorded.exposure
        return Captured(
            embedding=np.asarray(capture),
            taken_at=capture.taken_at,
            epoch=capture.epoch,
            reader=_Recollection(recorded),
            started_after_shown=exposure.started_after_shown_s,
            settle=exposure.settle_s,
            duration=exposure.duration_s,
            rotation_time=0.0,
            settle_time=0.0,
            capture_time=0.0,
            scene=capture.scene,
            replay=Replay(capture=capture.id, place=place, exposure=exposure),
        )

    def _require_running(self) -> None:
        """Before masks change, the panel is tested or the device is lent: never here."""
        raise ReplayingError


@dataclass(frozen=True, slots=True)
class _Recollection:
    """Tells of a capture what was recorded of it."""

    recorded: Recorded = field(repr=False)

    def classify(self, embedding: Reading) -> Verdict:  # noqa: ARG002 - nothing is inferred
        verdict = self.recorded.verdict
        if verdict is None:
            raise ReplayingError(
                "this capture was recorded without its label: record with 'veilcam record --labels'"
            )
        return Verdict(verdict.label, verdict.confidence, verdict.scores)

    def release(self, embedding: Reading, form: Form) -> Reading:  # noqa: ARG002 - it was checked
        """It was released before it was recorded."""
        return embedding


class _NoPanel:
    name, resets = "none", 0

    def show(self, levels: Levels) -> Shown:  # noqa: ARG002 - nothing shows it
        raise DisplayError("there is no panel: a recording is replayed")

    def blank(self) -> None:
        """Nothing is as opaque as it can be."""

    def close(self) -> None:
        """Nothing was opened."""


class _NoSensor:
    name, full_scale = "none", 1.0

    def capture(self, not_before: float, timeout: float) -> Exposure:  # noqa: ARG002 - as above
        raise SensorError("there is no sensor: a recording is replayed")

    def close(self) -> None:
        """Nothing was opened."""


class _NoTest:
    def run(self, device: Device, fence: Fence) -> None:  # noqa: ARG002 - nothing to test
        raise ReplayingError


class _NoMasks:
    renewable = False

    def name(self, counter: int) -> str:  # noqa: ARG002 - no epoch begins
        raise ReplayingError

    def make(self, counter: int, last_mark: str) -> Mask:  # noqa: ARG002 - as above
        raise ReplayingError


class _NoKeyrings(Keyrings):
    """Refuses everything: labels are those that were recorded."""

    def __init__(self) -> None:
        self.limit, self.faults = 1024, ()

    async def all(self) -> KeyringsAnswer:
        raise ReplayingError

    async def install(self, chunks: AsyncIterable[bytes]) -> Keyring:  # noqa: ARG002
        raise ReplayingError

    async def activate(self, digest: str, change: Change) -> Keyring:  # noqa: ARG002
        raise ReplayingError

    async def remove(self, digest: str) -> KeyringsAnswer:  # noqa: ARG002
        raise ReplayingError
