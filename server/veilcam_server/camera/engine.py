"""The seam between a service and what takes its captures: a masked camera, or a recording."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from contextlib import AbstractContextManager
from typing import Any, NamedTuple, Protocol, TypeVar

from veilcam_client.wire.calibration import SignedCalibration
from veilcam_client.wire.events import Event
from veilcam_client.wire.rotation import Rotation, RotationPolicy
from veilcam_client.wire.status import Remedy, State
from veilcam_server.camera.capture import Captured
from veilcam_server.camera.epochs import Epoch
from veilcam_server.devices.base import Device
from veilcam_server.masks.source import MaskSource

ResultT = TypeVar("ResultT")

Publish = Callable[[Callable[..., Event]], None]
"""Takes what makes an event of an ``id`` and the time ``at``; neither blocks nor fails."""


class Condition(NamedTuple):
    """State of a camera, or of the daemon."""

    state: State
    detail: str | None = None
    """Why it is not ready."""
    remedy: Remedy | None = None
    """What helps, where it is ``degraded`` or ``safe``."""


class OnDevice(Protocol):
    """Function that does work on the device's thread."""

    def __call__(
        self, work: Callable[[], ResultT], *, counted: bool = True
    ) -> Coroutine[Any, Any, ResultT]:
        """Return the result of ``work``, or raise its exception."""


class CameraEngine(Protocol):
    """Takes captures and changes masks, one thing at a time. Blocks: call it from a thread."""

    policy: RotationPolicy

    @property
    def state(self) -> Condition:
        """State of the camera."""

    def listen(self, publish: Publish) -> None:
        """Publish every new state and mask, from the thread that makes it so."""

    def healthy(self) -> bool:
        """Return whether panel and camera still answer."""

    def rotation(self) -> Rotation:
        """Return the policy, the present epoch, and whether the next one is ready."""

    def due_in(self) -> float:
        """Seconds until the mask must change; inf when nothing is planned."""

    def await_next(self) -> None:
        """Wait until no mask is being prepared."""

    def test_due_in(self) -> float:
        """Seconds until the panel must be tested, or tested again after a test that failed."""

    def test_if_due(self) -> None:
        """Test the panel if that is due, and show a mask again."""

    def rotate(self) -> None:
        """Show another mask now."""

    def rotate_if_due(self) -> None:
        """Show another mask if the policy wants it and one is ready."""

    def capture(self, *, release: bool) -> Captured:
        """Take one measurement under one mask, whose embedding may leave or may not."""

    def renew(self) -> None:
        """Discard the mask prepared in advance: who receives has changed."""

    def first_of(self, source: MaskSource) -> Epoch:
        """Prepare a mask of another source, while the camera goes on; any thread may ask."""

    def change_source(self, source: MaskSource, first: Epoch) -> None:
        """Show a mask of another source; the next ones come from there, too."""

    def rest(self, reason: str) -> None:
        """Make the panel opaque, and take no capture until :meth:`wake`."""

    def wake(self) -> None:
        """Show a mask again after :meth:`rest`."""

    def exclusive(self) -> AbstractContextManager[Device]:
        """Have the device as it is; no mask is shown and no capture taken meanwhile."""

    def adopt(
        self,
        calibration: SignedCalibration,
        settle: float,
        source: MaskSource,
    ) -> None:
        """Within :meth:`exclusive`: go on with another calibration."""

    def stop(self) -> None:
        """Show opaque and let go of the device; twice does no harm."""
