"""The camera for an event loop: what the API does."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from veilcam_client import __version__
from veilcam_client.wire.base import API_VERSION
from veilcam_client.wire.bundles import Keyring
from veilcam_client.wire.captures import (
    Capture,
    Classification,
    Embedding,
    Form,
    Prediction,
    Release,
)
from veilcam_client.wire.events import Event
from veilcam_client.wire.rotation import Rotation, RotationPolicy
from veilcam_client.wire.simulation import HeldScene
from veilcam_client.wire.status import Queue, State, Status
from veilcam_server.bundles.loader import Identity, Keys
from veilcam_server.bundles.manager import Keyrings
from veilcam_server.calibration.service import Calibrator
from veilcam_server.calibration.workshop import Workshop
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import Captured
from veilcam_server.devices.errors import SensorLostError
from veilcam_server.devices.simulated.images import PictureError, as_scene
from veilcam_server.devices.simulated.scenes import Scenes
from veilcam_server.errors import (
    KeyringInvalidError,
    ProblemError,
    ReplayingError,
    RotationImpossibleError,
    SceneApiOffError,
    SceneInvalidError,
    WithheldError,
)
from veilcam_server.service.events import History, News
from veilcam_server.service.queue import DeviceQueue
from veilcam_server.service.responses import (
    capture_response,
    classification_response,
    rotation_response,
    timing,
)
from veilcam_server.service.scheduler import Scheduler

ResultT = TypeVar("ResultT")


class Service:
    """Everything that the API does. Lives on one event loop, between ``open`` and its end.

    Args:
        camera: with its first mask on the panel.
        identity: for the status.
        keyrings: of which one is in use.
        form: in which embeddings leave.
        queue_limit: how many requests may wait for the device, the one at work included.
        heartbeat: longest silence of an event stream [s].
        scenes: before which pictures may be held up; None: nobody may.
        workshop: that measures the camera; None: it cannot be measured.
    """

    def __init__(
        self,
        camera: MaskedCamera,
        identity: Identity,
        keyrings: Keyrings,
        *,
        form: Release = "none",
        queue_limit: int = 8,
        heartbeat: float = 10.0,
        scenes: Scenes | None = None,
        workshop: Workshop | None = None,
    ) -> None:
        self._camera, self._identity, self._form = camera, identity, form
        self.keyrings, self._scenes = keyrings, scenes
        self._queue, self._news = DeviceQueue(queue_limit), News(heartbeat)
        self._scheduler = Scheduler(camera, rotating=self._on_device, testing=self._watched)
        self.calibrator = Calibrator(
            camera,
            keyrings,
            workshop,
            identity.calibration,
            on_device=self._on_device,
            tell=self._news.calibration_changed,
        )
        self._on_lost: Callable[[], None] = _ignore
        self._lost: SensorLostError | None = None
        self._captures = 0
        self._since = time.monotonic()
        self._inference_thread = ThreadPoolExecutor(1, "inference")
        camera.listen(self._news.mask_changed, self._state_changed, self._next_ready)

    @asynccontextmanager
    async def open(self) -> AsyncIterator[None]:
        """Keep the camera ready within; then show opaque and let go of the device."""
        with self._news.open(*self._camera.state):
            for detail in self.keyrings.faults:
                self._news.fault(KeyringInvalidError(detail))
            try:
                async with self._scheduler.running():
                    yield
            finally:
                await self._close()

    async def _close(self) -> None:
        self.end_streams()
        try:
            await self.calibrator.close()
            await self._queue.run(self._camera.stop)
        finally:
            self._queue.close()
            self._inference_thread.shutdown()

    @property
    def lost(self) -> SensorLostError | None:
        """Why the daemon has to be started again; None if it need not."""
        return self._lost

    def on_lost(self, act: Callable[[], None]) -> None:
        """Call ``act``, on the event loop, when the daemon has to be started again."""
        self._on_lost = act

    def stop(self) -> None:
        """Show opaque and let go of the device, without an event loop; twice does no harm."""
        self._camera.stop()

    def end_streams(self) -> None:
        """End all event streams, so that the server need not wait for who listens to them."""
        self._news.end_streams()

    @property
    def history(self) -> History:
        """What happened since the start."""
        return self._news.history

    def status(self) -> Status:
        """State, device, bundle, rotation and queue."""
        state, detail = self._camera.state
        return Status(
            version=__version__,
            api_version=API_VERSION,
            state=state,
            detail=detail,
            experiment=self._identity.experiment,
            uptime_s=time.monotonic() - self._since,
            captures=self._captures,
            release=self._form,
            device=self._identity.device,
            bundle=self._identity.bundle,
            rotation=self.rotation(),
            queue=Queue(waiting=self._queue.waiting, limit=self._queue.limit),
        )

    @property
    def release(self) -> Release:
        """In which form embeddings leave."""
        return self._form

    def rotation(self) -> Rotation:
        """The policy, the present epoch, and whether the next one is ready."""
        return rotation_response(self._camera)

    def set_policy(self, policy: RotationPolicy) -> Rotation:
        """Change when masks change; raises :class:`RotationImpossibleError`."""
        self._camera.policy = policy
        self._news.policy_changed(policy)
        self._scheduler.wake()
        return self.rotation()

    async def rotate(self) -> Rotation:
        """Show another mask now; raises as :meth:`MaskedCamera.rotate`, or the queue is full."""
        with self._admitted():
            try:
                await self._on_device(self._camera.rotate)
            finally:
                self._scheduler.wake()
        return self.rotation()

    async def capture(self) -> Capture:
        """Take one embedding; raises as :meth:`MaskedCamera.capture`, or the queue is full.

        Raises:
            WithheldError: this daemon releases no embeddings.
        """
        begun = time.monotonic()
        form = self._require_released()
        with self._admitted():
            captured, queued, released = await self._take(
                begun, lambda captured: _released(captured, form)
            )
            name = self._taken(captured)
            embedding = await asyncio.wrap_future(released)
        return capture_response(name, captured, embedding, timing(captured, queued, begun))

    async def classify(self, *, include_embedding: bool) -> Classification:
        """Take one embedding and classify it with the reader of its own mask.

        Raises:
            WithheldError: the embedding is wanted, and this daemon releases none.
        """
        begun = time.monotonic()
        form = self._require_released() if include_embedding else None

        def infer(captured: Captured) -> tuple[Prediction, Embedding | None, float]:
            started = time.perf_counter()
            prediction = captured.reader.classify(captured.embedding)
            took = time.perf_counter() - started
            return prediction, _released(captured, form) if form else None, took

        with self._admitted():
            captured, queued, inferred = await self._take(begun, infer)
            name = self._taken(captured)
            prediction, embedding, inference = await asyncio.wrap_future(inferred)
        self._news.classified(name, captured, prediction)
        return classification_response(
            name, captured, prediction, embedding, timing(captured, queued, begun, inference)
        )

    async def hold_scene(self, content: bytes | None) -> HeldScene:
        """Hold a picture up before a simulated camera, between two captures; None: take it away.

        Raises:
            SceneApiOffError: that is not allowed here.
            SceneInvalidError: it is no picture.
        """
        scenes = self._scenes
        if scenes is None:
            raise SceneApiOffError
        picture = None if content is None else await asyncio.to_thread(_picture, content, scenes)
        with self._admitted():
            # In line with captures and self tests, so that none of them sees two scenes.
            number = await self._on_device(lambda: scenes.hold(picture))
        return HeldScene(scene=number)

    async def activate_keyring(self, digest: str) -> Keyring:
        """Use another keyring from now on; raises as :meth:`Keyrings.activate`, or as `rotate`."""
        return await self.keyrings.activate(digest, self._use)

    async def _use(self, keys: Keys) -> None:
        """Show a mask of other keys, and read behind it with them, or change nothing."""
        with self._admitted():
            prepare = self._camera.preparation.first_of
            first = await asyncio.to_thread(prepare, keys.source)
            await self._on_device(lambda: self._camera.change_source(keys.source, first))
        self._identity = replace(self._identity, bundle=keys.info)
        self._news.keyring_changed(keys.info)
        self._scheduler.wake()

    def events(self, last_event_id: str | None) -> AsyncIterator[Event | None]:
        """Events after ``last_event_id``; None is a heartbeat."""
        return self._news.follow(last_event_id)

    def _state_changed(self, state: State, detail: str | None) -> None:
        self._news.state_changed(state, detail)
        self._news.on_loop(self._scheduler.wake)

    @contextmanager
    def _admitted(self) -> Iterator[None]:
        """Take a place in the queue, unless the device will be busy for minutes."""
        self.calibrator.require_idle()
        with self._queue.admitted():
            yield

    def _next_ready(self) -> None:
        self._news.on_loop(self._scheduler.wake)

    async def _take(
        self, begun: float, aside: Callable[[Captured], ResultT]
    ) -> tuple[Captured, float, Future[ResultT]]:
        """Take one reading, and begin ``aside`` on it while the device serves the next request."""

        def work() -> tuple[Captured, float, Future[ResultT]]:
            queued = time.monotonic() - begun
            captured = self._camera.capture()
            # From here and not from the event loop, which would only hand it on.
            return captured, queued, self._inference_thread.submit(aside, captured)

        try:
            return await self._on_device(work)
        finally:
            self._scheduler.wake()

    def _require_released(self) -> Form:
        if self._form == "none":
            raise WithheldError(
                "this daemon releases no embeddings: ask for a classification, "
                "or start it with --release"
            )
        return self._form

    def _taken(self, captured: Captured) -> str:
        name = secrets.token_hex(8)
        self._captures += 1
        self._news.captured(name, captured)
        return name

    async def _on_device(self, work: Callable[[], ResultT], *, counted: bool = True) -> ResultT:
        try:
            return await self._watched(work, counted=counted)
        except (RotationImpossibleError, ReplayingError):
            raise
        except ProblemError as error:
            self._news.fault(error)
            raise

    async def _watched(self, work: Callable[[], ResultT], *, counted: bool = True) -> ResultT:
        try:
            return await self._queue.run(work, counted=counted)
        except SensorLostError as error:
            self._lost = error
            self._on_lost()
            raise


def _picture(content: bytes, scenes: Scenes) -> npt.NDArray[np.float32]:
    try:
        return as_scene(content, scenes.shape)
    except PictureError as error:
        raise SceneInvalidError(f"this {error}") from None


def _ignore() -> None:
    """Nobody wants to know."""


def _released(captured: Captured, form: Form) -> Embedding:
    values = captured.reader.release(captured.embedding, form)
    return Embedding.from_array(values, form=form)
