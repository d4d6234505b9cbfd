"""The camera for an event loop: what the API does."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial

import structlog

from veilcam_client import __version__
from veilcam_client.keys.commitments import ID_DIGITS, NAME_DIGITS
from veilcam_client.wire.base import API_VERSION
from veilcam_client.wire.bundles import BundleInfo, InstalledBundle
from veilcam_client.wire.captures import Capture, Classification
from veilcam_client.wire.events import (
    BundleChanged,
    CaptureTaken,
    Classified,
    Event,
    RotationChanged,
    StateChanged,
)
from veilcam_client.wire.rotation import Rotation, RotationPolicy
from veilcam_client.wire.sealing import Release
from veilcam_client.wire.simulation import HeldScene
from veilcam_client.wire.status import Queue, Status
from veilcam_client.wire.watch import Watch, WatchPolicy
from veilcam_server.bundles.loader import LoadedBundle
from veilcam_server.bundles.manager import BundleManager
from veilcam_server.calibration.service import Served
from veilcam_server.camera.budget import nobody_receives, withheld
from veilcam_server.camera.capture import Captured
from veilcam_server.devices.errors import DisplayError
from veilcam_server.errors import ProblemError, ReplayingError, StorageError, UnsteadyLightError
from veilcam_server.masks.source import Evidence
from veilcam_server.sealing.receivers import Pairing
from veilcam_server.security.log import Log
from veilcam_server.service.events import EventPublisher, History, log_event, tell_systemd
from veilcam_server.service.queue import DeviceQueue
from veilcam_server.service.responses import Readers, Scores
from veilcam_server.service.scheduler import Alarms, Scheduler
from veilcam_server.service.served_camera import ServedCamera, Simulation
from veilcam_server.service.state import State
from veilcam_server.system.clock import MachineClock
from veilcam_server.system.logs import log_unhandled
from veilcam_server.watch.watcher import Watched, Watcher

log = structlog.get_logger()
_NO_SCENES = "this daemon takes no scenes and no faults: start it with --simulate --scene-api"


class Service:
    """Everything that the API does. Lives on one event loop, between ``open`` and its end.

    Args:
        camera: camera with its first mask on the panel, or a recording.
        state: state of the daemon.
        queue_limit: greatest number of requests that wait for the device, the one at work included.
        heartbeat: longest silence of an event stream [s].
    """

    def __init__(
        self, camera: ServedCamera, state: State, *, queue_limit: int = 8, heartbeat: float = 10.0
    ) -> None:
        self._camera, self._identity = camera.engine, camera.identity
        self._state, self._heartbeat = state, heartbeat
        self.report = state.report
        self._releases, self._policies = camera.releases, camera.policies
        self._bundles, self._simulation = camera.bundles, camera.simulation
        self._pairing: Pairing | None = None
        self._setting_policy = asyncio.Lock()
        self._events, self.history = EventPublisher(), History()
        publish = self._events.publish
        self._alarms = Alarms(self._camera, publish)
        self._queue = DeviceQueue(queue_limit, publish)
        self._scheduler = Scheduler(self._camera, self._queue, self._alarms)
        self._watcher: Watcher | None = None
        self._clock = MachineClock() if camera.watch is None else camera.watch.clock
        if camera.watch is not None:
            busy = lambda: self._queue.waiting > 0  # noqa: E731
            tell = self._events.log.tell
            watched = Watched(self._camera, self._queue.run, self._look, busy, publish, tell)
            self._watcher = Watcher(camera.watch, watched)
            self._scheduler.add("watch", self._watcher.look_due_in, self._watcher.look)
            self._scheduler.add("beat", self._watcher.beat_due_in, self._watcher.beat)
            self._scheduler.add("quiet hours", self._watcher.rest_due_in, self._watcher.rest)
        self.calibration = camera.calibration
        if self._bundles is not None:
            self._pairing = Pairing(state.receivers, state.key.public, self._camera.renew)
            self.calibration.serve(Served(self._camera, self._bundles, self._queue.run, publish))
        for task, take in (
            ("count of events", self.history.add),
            ("log of events", log_event),
            ("notice to systemd", tell_systemd),
            ("schedule", self._scheduler.wake),
        ):
            self._events.subscribe(self._alarms.guarded(task, take))
        self._since = time.monotonic()
        self.log.begin(self.report)
        self._readers = Readers(self.log)
        self._camera.listen(self._alarms.pass_on)

    @asynccontextmanager
    async def open(self) -> AsyncIterator[None]:
        """Keep the camera ready within; then show opaque and let go of the device."""
        asyncio.get_running_loop().set_exception_handler(log_unhandled)
        begun = StateChanged(id="", at=datetime.now(UTC), **self._alarms.state._asdict())
        for take in (self.history.enter, log_event, tell_systemd):
            take(begun)
        with self._events.open():
            self._state.listen(self._events.publish)
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
            self._readers.close()
            self._let_go()

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
        self.log.close()
        self._state.close()

    def end_streams(self) -> None:
        """End all event streams, so that the server need not wait for who listens to them."""
        self._events.log.close()
        self._events.public.close()

    @property
    def bundles(self) -> BundleManager:
        """Return the bundles; raises :class:`ReplayingError` where there are none."""
        if self._bundles is None:
            raise ReplayingError
        return self._bundles

    @property
    def bundle(self) -> BundleInfo:
        """Bundle in use."""
        return self._identity.bundle

    @property
    def release(self) -> Release:
        """In which form embeddings leave, from the next epoch on."""
        return self._releases.form()

    @property
    def pairing(self) -> Pairing:
        """With receivers; raises :class:`ReplayingError` where there are none."""
        if self._pairing is None:
            raise ReplayingError
        return self._pairing

    @property
    def log(self) -> Log:
        """Log of what leaves, and of who changes it."""
        return self._state.log

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
            raw_budget=self._releases.raw_budget,
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
        name = secrets.token_hex(ID_DIGITS // 2)
        with self._admitted():
            # On the thread of the device: lock, mask due, frame, guard.
            captured, queued = await self._captured(name, release=include_embedding)
            # On the thread of readers, while the device serves the next: label, log, answer.
            embedded = queued if include_embedding else None
            answer = await self._readers.classification(name, captured, scores, embedded, caller)
        self._events.publish(
            partial(
                Classified,
                capture=name[:NAME_DIGITS],
                epoch=answer.epoch,
                label=answer.label,
                replay=answer.replay is not None,
            )
        )
        return answer

    async def capture(self, caller: str | None = None) -> Capture:
        """Take one embedding; raises as :meth:`CameraEngine.capture`, or the queue is full.

        Args:
            caller: caller that it leaves to.

        Raises:
            ProblemError: this daemon releases no embeddings, or to nobody.
        """
        self._require_released()
        name = secrets.token_hex(ID_DIGITS // 2)
        with self._admitted():
            captured, queued = await self._captured(name, release=True)
            return await self._readers.embedding(name, captured, queued, caller)

    @property
    def simulation(self) -> Simulation:
        """Return the simulation; raises :class:`ProblemError` where callers may not set it."""
        if self._simulation is None:
            raise ProblemError("not_enabled", _NO_SCENES)
        return self._simulation

    async def hold_scene(self, content: bytes | None) -> HeldScene:
        """Hold a picture up before a simulated camera, between two captures; None: take it away.

        Raises:
            ProblemError: that is not allowed here, or it is no picture.
        """
        simulation, picture, warning = self.simulation, None, None
        if content is not None:
            picture, warning = await asyncio.to_thread(simulation.picture, content)
        with self._admitted():
            # In line with captures and self tests, so that none of them sees two scenes.
            number = await self._queue.run(partial(simulation.scenes.hold, picture))
        return HeldScene(scene=number, warning=warning)

    async def activate_bundle(self, digest: str, *, allow_older: bool = False) -> InstalledBundle:
        """Use another bundle from now on; raises as :meth:`Bundles.activate`, or as `rotate`."""
        return await self.bundles.activate(digest, self._use, allow_older=allow_older)

    async def _use(self, keys: LoadedBundle) -> None:
        """Show a mask of other keys, and read behind it with them, or change nothing."""
        with self._admitted():
            first = await asyncio.to_thread(self._camera.first_of, keys.source)
            await self._queue.run(partial(self._camera.change_source, keys.source, first))
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

    def events(
        self, last_event_id: str | None, *, labels: bool = True
    ) -> AsyncIterator[Event | None]:
        """Events after ``last_event_id``; None is a heartbeat.

        Args:
            last_event_id: the last one the listener has seen; None: all from this call on.
            labels: True: those that tell labels are among them, and the states of the watch.
        """
        events = self._events.log if labels else self._events.public
        return events.follow(last_event_id, self._heartbeat)

    @contextmanager
    def _admitted(self) -> Iterator[None]:
        """Take a place in the queue, unless the device will be busy for minutes."""
        self.calibration.require_idle()
        with self._queue.admitted():
            yield

    async def _captured(self, name: str, *, release: bool) -> tuple[Captured, float]:
        """Take one capture in turn; return it with the time that it waited for the device [s]."""
        try:
            captured, queued = await self._queue.capture(
                partial(self._camera.capture, release=release)
            )
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
        return captured, queued

    async def _look(self) -> Evidence:
        """Take one capture of which nothing leaves; raises as :meth:`CameraEngine.capture`."""
        captured, _ = await self._queue.capture(partial(self._camera.capture, release=False))
        return await self._readers.evidence(captured)

    def _require_released(self) -> None:
        form = self.release
        if form == "none":
            raise withheld()
        if form == "sealed" and self._pairing is not None and not self._pairing.paired:
            raise nobody_receives()
