"""A recording in the place of a camera: the API answers what was recorded, and says so.

There is no panel and no sensor, so nothing is exposed, no mask is shown, and nothing is proven:
what the recording tells of its exposures is handed on as the recording's own word.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import NoReturn

from veilcam_client.errors import FileError
from veilcam_client.recording import Recorded, Recording, read_recording
from veilcam_client.wire.captures import Embedding, Prediction, Replay, SealedEmbedding
from veilcam_client.wire.events import StateChanged
from veilcam_client.wire.rotation import Preparation, Rotation, RotationOff, RotationPolicy
from veilcam_client.wire.sealing import Form
from veilcam_client.wire.status import Device as DeviceInfo
from veilcam_server.bundles.loader import Identity
from veilcam_server.calibration.service import CalibrationService
from veilcam_server.camera.capture import Captured
from veilcam_server.camera.engine import Condition, Publish
from veilcam_server.errors import ReplayingError, StartError
from veilcam_server.masks.source import Evidence
from veilcam_server.service.served_camera import Releases, ServedCamera
from veilcam_server.settings import Settings


def replayed_camera(settings: Settings, path: Path) -> ServedCamera:
    """Return a camera that answers from a recording.

    Raises:
        StartError: it cannot be read.
    """
    try:
        recording = read_recording(path)
    except FileError as error:
        raise StartError(str(error)) from None
    status = recording.header.status
    if status.release == "none":  # no camera released these
        raise StartError(f"{path} was recorded from a camera that releases nothing: record another")
    form = status.release
    return ServedCamera(
        ReplayedCamera(recording),
        Identity(
            DeviceInfo(
                display=f"replay of {status.device.display}",
                sensor=f"replay of {status.device.sensor}",
                simulated=status.device.simulated,
                key=status.device.key,
            ),
            status.bundle,
            experiment=status.experiment,
        ),
        Releases(lambda: form, status.raw_budget),
        CalibrationService(settings, None, None),
    )


class ReplayedCamera:
    """Gives every recorded capture once, in their order. No mask is ever shown.

    Args:
        recording: recording of a camera.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._place, self._stopping = 0, False

    @property
    def state(self) -> Condition:
        """That this is a replay, and how far it is."""
        if self._stopping:
            return Condition("stopping", "the daemon is stopping")
        count, at = len(self._recording.captures), self._recording.header.recorded_at
        return Condition("replay", f"{self._place} of {count} captures recorded on {at:%Y-%m-%d}")

    @property
    def policy(self) -> RotationPolicy:
        """Masks do not change, as there are none."""
        return RotationOff()

    @policy.setter
    def policy(self, policy: RotationPolicy) -> None:
        if not isinstance(policy, RotationOff):
            raise ReplayingError

    def listen(self, publish: Publish) -> None:
        """Publish how it ends; nothing else happens by itself."""
        self._publish = publish

    def healthy(self) -> bool:
        """There is nothing that could hang."""
        return True

    def rotation(self) -> Rotation:
        """No mask is shown, and none prepared."""
        none = Preparation(ready=False, prepared=0, last_s=0.0, late=0, reused=0)
        return Rotation(policy=self.policy, epoch=None, captures=0, preparation=none)

    def _refuse(self, *_: object) -> NoReturn:
        """Refuse what needs a panel."""
        raise ReplayingError

    def _do_nothing(self) -> None:
        """No mask is prepared, shown or tested."""

    def _never(self) -> float:
        """No mask and no test is ever due."""
        return math.inf

    rotate = first_of = change_source = rest = exclusive = adopt = _refuse
    await_next = test_if_due = rotate_if_due = wake = renew = _do_nothing
    due_in = test_due_in = _never

    def stop(self) -> None:
        """Give nothing more."""
        if not self._stopping:
            self._stopping = True
            self._publish(partial(StateChanged, **self.state._asdict()))

    def capture(self, *, release: bool) -> Captured:  # noqa: ARG002 - it was released long ago
        """Return the next recorded capture.

        Raises:
            ReplayingError: there is none left.
        """
        captures = self._recording.captures
        if self._place == len(captures):
            raise ReplayingError(
                f"all {len(captures)} captures were replayed: start the daemon again"
            )
        place, recorded = self._place, captures[self._place]
        self._place += 1
        return _Recollection(recorded, place)


@dataclass(frozen=True, slots=True)
class _Recollection:
    """Tells of a capture what was recorded of it."""

    recorded: Recorded = field(repr=False)
    place: int

    @property
    def epoch(self) -> str:
        """Epoch of the mask that was shown."""
        return self.recorded.capture.epoch

    @property
    def number(self) -> int:
        """As it was then."""
        return self.recorded.capture.number

    @property
    def taken_at(self) -> datetime:
        """As it was then."""
        return self.recorded.capture.taken_at

    @property
    def form(self) -> Form:
        """In which it left."""
        return self.recorded.capture.embedding.form

    @property
    def replay(self) -> Replay:
        """Origin of the capture."""
        return Replay(capture=self.recorded.capture.id, place=self.place)

    @property
    def provenance(self) -> None:
        """Nothing was taken, so nothing is logged."""
        return

    def classify(self) -> Prediction:
        """Nothing is inferred: what was told then."""
        verdict = self.recorded.verdict
        if verdict is None:
            raise ReplayingError(
                "this capture was recorded without its label: record with 'veilcam record --labels'"
            )
        return verdict

    def evidence(self) -> Evidence:
        """Refused: labels alone were recorded."""
        raise ReplayingError

    def release(self, queue_s: float) -> Embedding | SealedEmbedding:  # noqa: ARG002 - as it left
        """Do nothing: the capture was released before it was recorded."""
        return self.recorded.capture.embedding

    def done(self) -> None:
        """There is no mask to let go of."""
