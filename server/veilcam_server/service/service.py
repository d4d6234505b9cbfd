"""The camera for an event loop: what the API does."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from typing import TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt
import structlog

from veilcam_client import __version__
from veilcam_client.keys.commitments import ID_DIGITS, NAME_DIGITS
from veilcam_client.wire.base import API_VERSION
from veilcam_client.wire.bundles import InstalledBundle
from veilcam_client.wire.captures import Capture, Classification
from veilcam_client.wire.events import (
    BundleChanged,
    CaptureTaken,
    Classified,
    Event,
    Fault,
    RotationChanged,
    StateChanged,
)
from veilcam_client.wire.rotation import Rotation, RotationPolicy
from veilcam_client.wire.sealing import Release
from veilcam_client.wire.simulation import Faults, HeldScene
from veilcam_client.wire.status import Queue, Status
from veilcam_client.wire.watch import Watch, WatchPolicy
from veilcam_optics.pictures import PictureError
from veilcam_server.bundles.loader import Identity, LoadedBundle
from veilcam_server.bundles.manager import BundleManager
from veilcam_server.calibration.service import CalibrationService, Served
from veilcam_server.camera.budget import nobody_receives, withheld
from veilcam_server.camera.capture import Captured
from veilcam_server.camera.engine import CameraEngine
from veilcam_server.devices.errors import DisplayError
from veilcam_server.devices.simulated.images import as_scene, decoded, range_warning
from veilcam_server.devices.simulated.scenes import Scenes
from veilcam_server.errors import (
    ProblemError,
    ReplayingError,
    StorageError,
    UnsteadyLightError,
)
from veilcam_server.masks.source import Evidence
from veilcam_server.security.log import Log
from veilcam_server.service.alarms import Alarms
from veilcam_server.service.events import EventPublisher, History, log_event, tell_systemd
from veilcam_server.service.pairing import Pairing
from veilcam_server.service.queue import DeviceQueue
from veilcam_server.service.responses import (
    Scores,
    capture_response,
    classification_response,
    logged,
)
from veilcam_server.service.rotation_policy import PolicyStore
from veilcam_server.service.scheduler import Scheduler
from veilcam_server.system.clock import MachineClock
from veilcam_server.system.logs import log_unhandled
from veilcam_server.system.state_file import HeldDirectory
from veilcam_server.watch.watcher import Watched, Watcher, WatchSetup

log = structlog.get_logger()
_NO_SCENES = "this daemon takes no scenes and no faults: start it with --simulate --scene-api"
AnswerT = TypeVar("AnswerT", Capture, Classification)
MakeAnswer: TypeAlias = Callable[[str, Captured, float], AnswerT]
"""Makes an answer of its id, the capture, and what the request waited for the device [s]."""


class Service:
    """Everything that the API does. Lives on one event loop, between ``open`` and its end.

    Args:
        camera: camera with its first mask on the panel.
        identity: identity for the status.
        log: log of what leaves, and of who changes it.
        bundles: bundles, of which one is in use; None: labels and masks come from a recording.
        calibration: calibration that measures the camera.
        form: tells in which embeddings leave, from the next epoch on.
        raw_budget: embeddings that may leave raw behind one mask; for the status.
        pairing: pairing with receivers; None: a recording is replayed, and there are none.
        queue_limit: greatest number of requests that wait for the device, the one at work included.
        heartbeat: longest silence of an event stream [s].
        scenes: before which pictures may be held up; None: nobody may.
        break_device: breaks and mends a simulated device; None: nobody may.
        faults: faults that were found before; they are told once this is open.
        policies: store of the rotation policy; None: it lasts no longer than this.
        watch: settings of the watch; None: a recording is replayed.
        held: state directory, which other daemons may have once this has stopped; None: there is
            none.
    """

    def __init__(
        self,
        camera: CameraEngine,
        identity: Identity,
        log: Log,
        bundles: BundleManager | None,
        calibration: CalibrationService,
        *,
        form: Callable[[], Release],
        raw_budget: int = 0,
        pairing: Pairing | None = None,
        queue_limit: int = 8,
        heartbeat: float = 10.0,
        scenes: Scenes | None = None,
        break_device: Callable[[Faults], None] | None = None,
        faults: Sequence[ProblemError] = (),
        policies: PolicyStore | None = None,
        watch: WatchSetup | None = None,
        held: HeldDirectory | None = None,
    ) -> None:
        self._camera, self._identity, self._heartbeat = camera, identity, heartbeat
        self._form, self._raw_budget, self._pairing = form, raw_budget, pairing
        self._bundles, self._scenes, self._policies = bundles, scenes, policies
        self._break, self._held, self._log = break_device, held, log
        self._setting_policy = asyncio.Lock()
        self._events, self.history = EventPublisher(), History()
        publish = self._events.publish
        self._alarms = Alarms(camera, publish)
        self._queue = DeviceQueue(queue_limit, publish)
        self._scheduler = Scheduler(camera, self._queue, self._alarms)
        self._watcher: Watcher | None = None
        self._clock = MachineClock() if watch is None else watch.clock
        if watch is not None:
            self._watcher = Watcher(
                watch,
                Watched(
                    camera,
                    on_device=self._queue.run,
                    look=self._look,
                    busy=lambda: self._queue.waiting > 0,
                    publish=publish,
                ),
            )
            self._scheduler.add("watch", self._watcher.look_due_in, self._watcher.look)
            self._scheduler.add("quiet hours", self._watcher.rest_due_in, self._watcher.rest)
        self.calibration = calibration
        if bundles is not None:
            calibration.serve(Served(camera, bundles, self._queue.run, publish))
        for task, take in (
            ("count of events", self.history.add),
            ("log of events", log_event),
            ("notice to systemd", tell_systemd),
            ("schedule", self._scheduler.wake),
        ):
            self._events.subscribe(self._alarms.guarded(task, take))
        self._since = time.monotonic()
        self._found: list[ProblemError] | None = list(faults)
        log.begin(self.report)
        self._inference_thread = ThreadPoolExecutor(1, "inference")
        camera.listen(self._alarms.pass_on)

    @asynccontextmanager
    async def open(self) -> AsyncIterator[None]:
        """Keep the camera ready within; then show opaque and let go of the device."""
        asyncio.get_running_loop().set_exception_handler(log_unhandled)
        begun = StateChanged(id="", at=datetime.now(UTC), **self._alarms.state._asdict())
        for take in (self.history.enter, log_event, tell_systemd):
            take(begun)
        with self._events.open():
            found, self._found = self._found or (), None
            for fault in found:
                self.report(fault)
            try:
                async with self._scheduler.running():
                    yield
            finally:
                await self._close()

    async def _close(self) -> None:
        self.end_streams()
        try:
            await self.calibration.close()
            await self._queue.run(self._camera.stop)
        except DisplayError as error:
            log.error("the panel could not be made opaque at the end", reason=str(error))
        finally:
            self._queue.close()
            self._inference_thread.shutdown()
            self._let_go()

    def report(self, fault: ProblemError) -> None:
        """Tell of a fault that ended nothing; from whatever thread, and before this is open too."""
        if self._found is not None:
            self._found.append(fault)
        else:
            self._events.publish(
                partial(Fault, code=fault.code, detail=str(fault), remedy=fault.remedy)
            )

    def healthy(self) -> bool:
        """Return whether panel and camera still answer."""
        return self._camera.healthy()

    def stop(self) -> None:
        """Show opaque and let go of the device, without an event loop; twice does no harm."""
        try:
            self._camera.stop()
        finally:
            self._let_go()

    def _let_go(self) -> None:
        self._log.close()
        if self._held is not None:
            self._held.close()

    def end_streams(self) -> None:
        """End all event streams, so that the server need not wait for who listens to them."""
        self._events.log.close()

    @property
    def bundles(self) -> BundleManager:
        """Return the bundles; raises :class:`ReplayingError` where there are none."""
        if self._bundles is None:
            raise ReplayingError
        return self._bundles

    @property
    def release(self) -> Release:
        """In which form embeddings leave, from the next epoch on."""
        return self._form()

    @property
    def pairing(self) -> Pairing:
        """With receivers; raises :class:`ReplayingError` where there are none."""
        if self._pairing is None:
            raise ReplayingError
        return self._pairing

    @property
    def log(self) -> Log:
        """Log of what leaves, and of who changes it."""
        return self._log

    @property
    def watcher(self) -> Watcher:
        """That looks by itself; raises :class:`ReplayingError` where there is none."""
        if self._watcher is None:
            raise ReplayingError
        return self._watcher

    def give_way(self, leased: Callable[[], bool]) -> None:
        """Let the camera not look by itself while somebody holds it."""
        if self._watcher is not None:
            self._watcher.leased = leased

    async def set_watch(self, policy: WatchPolicy) -> Watch:
        """Change when the camera looks; raises as :meth:`Watcher.set_policy`.

        Raises:
            NotReadyError: the camera is being measured: cancel that first.
        """
        self.calibration.require_idle()
        return await self.watcher.set_policy(policy)

    @property
    def upload_limit(self) -> int:
        """Largest bundle [bytes]; 0 where there are none."""
        return 0 if self._bundles is None else self._bundles.limit

    def status(self) -> Status:
        """State, device, bundle, rotation and queue."""
        condition = self._alarms.state
        return Status(
            version=__version__,
            api_version=API_VERSION,
            **condition._asdict(),
            experiment=self._identity.experiment,
            uptime_s=time.monotonic() - self._since,
            captures=self.history.events["capture"],
            release=self.release,
            raw_budget=self._raw_budget,
            receivers=() if self._pairing is None else self._pairing.paired,
            device=self._identity.device,
            bundle=self._identity.bundle,
            rotation=self.rotation(),
            queue=Queue(waiting=self._queue.waiting, limit=self._queue.limit),
            clock=self._clock.told(),
        )

    def rotation(self) -> Rotation:
        """Return the policy, the present epoch, and whether the next one is ready."""
        return self._camera.rotation()

    async def set_policy(self, policy: RotationPolicy) -> Rotation:
        """Change when masks change, also after a restart.

        Raises:
            RotationImpossibleError: the policy needs another mask, and there is none.
            StorageError: it cannot be made durable; the one before goes on.
        """
        async with self._setting_policy:
            before, self._camera.policy = self._camera.policy, policy
            if self._policies is not None:
                try:
                    await asyncio.to_thread(self._policies.set, policy)
                except StorageError:
                    self._camera.policy = before
                    raise
        self._events.publish(partial(RotationChanged, policy=policy))
        return self.rotation()

    async def rotate(self) -> Rotation:
        """Show another mask now; raises as :meth:`CameraEngine.rotate`, or the queue is full."""
        with self._admitted():
            await self._queue.run(self._camera.rotate)
        return self.rotation()

    async def capture(self, caller: str | None = None) -> Capture:
        """Take one embedding; raises as :meth:`CameraEngine.capture`, or the queue is full.

        Args:
            caller: caller that it leaves to.

        Raises:
            ProblemError: this daemon releases no embeddings, or to nobody.
        """
        self._require_released()

        def answer(name: str, captured: Captured, queued: float) -> Capture:
            return capture_response(name, captured, captured.release(queued))

        with self._admitted():
            return await self._answered(answer, release=True, caller=caller)

    async def classify(
        self, *, include_embedding: bool, scores: Scores = "none", caller: str | None = None
    ) -> Classification:
        """Take one embedding and classify it with the reader of its own mask.

        Args:
            include_embedding: True: the embedding leaves, too.
            scores: scores that are told beside the label.
            caller: caller that it leaves to.

        Raises:
            ProblemError: the embedding is wanted, and it may not leave.
        """
        if include_embedding:
            self._require_released()

        def answer(name: str, captured: Captured, queued: float) -> Classification:
            prediction = captured.classify()
            embedding = captured.release(queued) if include_embedding else None
            return classification_response(name, captured, prediction, embedding, scores)

        with self._admitted():
            told = await self._answered(answer, release=include_embedding, caller=caller)
        self._events.publish(
            partial(
                Classified,
                capture=told.id[:NAME_DIGITS],
                epoch=told.epoch,
                label=told.label,
                replay=told.replay is not None,
            )
        )
        return told

    async def hold_scene(self, content: bytes | None) -> HeldScene:
        """Hold a picture up before a simulated camera, between two captures; None: take it away.

        Raises:
            ProblemError: that is not allowed here, or it is no picture.
        """
        scenes = self._scenes
        if scenes is None:
            raise ProblemError("not_enabled", _NO_SCENES)
        picture, warning = None, None
        if content is not None:
            picture, warning = await asyncio.to_thread(_picture, content, scenes)
        with self._admitted():
            # In line with captures and self tests, so that none of them sees two scenes.
            number = await self._queue.run(lambda: scenes.hold(picture))
        return HeldScene(scene=number, warning=warning)

    def set_faults(self, faults: Faults) -> Faults:
        """Break a simulated device, or mend it, also while it takes a capture.

        Raises:
            ProblemError: that is not allowed here.
        """
        if self._break is None:
            raise ProblemError("not_enabled", _NO_SCENES)
        self._break(faults)
        return faults

    async def activate_bundle(self, digest: str, *, allow_older: bool = False) -> InstalledBundle:
        """Use another bundle from now on; raises as :meth:`Bundles.activate`, or as `rotate`."""
        return await self.bundles.activate(digest, self._use, allow_older=allow_older)

    async def _use(self, keys: LoadedBundle) -> None:
        """Show a mask of other keys, and read behind it with them, or change nothing."""
        with self._admitted():
            first = await asyncio.to_thread(self._camera.first_of, keys.source)
            await self._queue.run(lambda: self._camera.change_source(keys.source, first))
        older = keys.info.version < self._identity.bundle.version
        self._identity = replace(self._identity, bundle=keys.info)
        self._events.publish(
            partial(
                BundleChanged,
                digest=keys.info.digest,
                task=keys.info.task,
                version=keys.info.version,
                older=older,
            )
        )

    def events(self, last_event_id: str | None) -> AsyncIterator[Event | None]:
        """Events after ``last_event_id``; None is a heartbeat."""
        return self._events.log.follow(last_event_id, self._heartbeat)

    @contextmanager
    def _admitted(self) -> Iterator[None]:
        """Take a place in the queue, unless the device will be busy for minutes."""
        self.calibration.require_idle()
        with self._queue.admitted():
            yield

    async def _answered(
        self, make: MakeAnswer[AnswerT], *, release: bool, caller: str | None
    ) -> AnswerT:
        """Take one measurement, and answer while the device serves the next one.

        Args:
            make: the answer.
            release: True: the embedding leaves.
            caller: caller that it leaves to.
        """
        begun, name = time.monotonic(), secrets.token_hex(ID_DIGITS // 2)

        def work() -> tuple[Captured, Future[AnswerT]]:
            queued = time.monotonic() - begun
            captured = self._camera.capture(release=release)
            try:
                # From here and not from the event loop, which would only hand it on.
                future = self._inference_thread.submit(
                    lambda: self._logged(make(name, captured, queued), captured, caller)
                )
            except BaseException:
                captured.done()
                raise
            # Also of one that is called off before its turn, as nobody waits for it any more.
            future.add_done_callback(lambda _: captured.done())
            return captured, future

        try:
            captured, answer = await self._queue.run(work)
        except UnsteadyLightError:
            # Its mask may be due: that is seen to before anybody asks again.
            self._scheduler.wake()
            raise
        self._events.publish(
            partial(
                CaptureTaken,
                capture=name[:NAME_DIGITS],
                epoch=captured.epoch,
                replay=captured.replay is not None,
            )
        )
        return await asyncio.wrap_future(answer)

    async def _look(self) -> Evidence:
        """Take one capture of which nothing leaves; raises as :meth:`CameraEngine.capture`."""

        def work() -> Future[Evidence]:
            captured = self._camera.capture(release=False)
            try:
                future = self._inference_thread.submit(captured.evidence)
            except BaseException:
                captured.done()
                raise
            future.add_done_callback(lambda _: captured.done())
            return future

        return await asyncio.wrap_future(await self._queue.run(work))

    def _logged(self, answer: AnswerT, captured: Captured, caller: str | None) -> AnswerT:
        """Return an answer once it is in the log; what is replayed is not logged."""
        if captured.provenance is not None:
            facts = logged(answer, captured.provenance, caller)
            self._log.append("capture", facts, at=answer.taken_at)
        return answer

    def _require_released(self) -> None:
        form = self.release
        if form == "none":
            raise withheld()
        if form == "sealed" and self._pairing is not None and not self._pairing.paired:
            raise nobody_receives()


def _picture(content: bytes, scenes: Scenes) -> tuple[npt.NDArray[np.float32], str | None]:
    """Return a picture of the scene's size, and what to say of it."""
    try:
        picture = decoded(content)
        scene, warning = as_scene(picture, scenes.shape), range_warning(picture)
    except PictureError as error:
        raise ProblemError("invalid_request", f"this {error}") from None
    fitted = scene if scene.ndim == 2 else np.moveaxis(scene, 0, 2)
    return fitted, None if warning is None else f"this {warning}"
