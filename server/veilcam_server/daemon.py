"""Daemon from its settings: every reason not to start is one :class:`StartError`."""

from __future__ import annotations

import signal
import socket
from collections.abc import Callable
from contextlib import ExitStack

import structlog
import uvicorn

from veilcam_client.wire.status import Device as DeviceInfo
from veilcam_server.api.app import create_app
from veilcam_server.bundles.hiding import HidingCheck
from veilcam_server.bundles.loader import (
    Identity,
    Opener,
    last_good,
    note_start,
    release_terms,
    rotation_policy,
)
from veilcam_server.bundles.manager import BundleManager
from veilcam_server.bundles.owners import Owners
from veilcam_server.bundles.store import BundleStore
from veilcam_server.calibration.record import (
    open_calibration,
    settle_time,
    source_opener,
)
from veilcam_server.calibration.service import CalibrationService
from veilcam_server.camera.budget import ReleaseBudget
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import Fence
from veilcam_server.camera.epochs import Preparation
from veilcam_server.camera.self_test import Checks, OpticalSelfTest
from veilcam_server.devices.errors import DeviceError
from veilcam_server.devices.registry import open_device
from veilcam_server.doctor.checkup import examine_beside
from veilcam_server.doctor.machine import Machine
from veilcam_server.errors import (
    BundleOlderError,
    BundleRefusedError,
    ProblemError,
    RotationImpossibleError,
    StartError,
)
from veilcam_server.gate.protocol import Connections
from veilcam_server.gate.server import GateServer
from veilcam_server.sealing.capture_log import CaptureLog
from veilcam_server.sealing.identity import DeviceKey
from veilcam_server.sealing.receivers import ReceiverStore
from veilcam_server.security.admission import open_admission
from veilcam_server.security.tls import server_context
from veilcam_server.service.pairing import Pairing
from veilcam_server.service.replay import replay_service
from veilcam_server.service.rotation_policy import PolicyStore
from veilcam_server.service.service import Service
from veilcam_server.settings import Settings
from veilcam_server.system.listeners import Listener, open_listeners, room_for
from veilcam_server.system.logs import log_defect
from veilcam_server.system.memory import forbid_core_files, no_garbage
from veilcam_server.system.state_file import HeldDirectory
from veilcam_server.system.systemd import notify
from veilcam_server.watch.watcher import open_watch
from veilcam_training.bundle import BundleError, read_bundle

log = structlog.get_logger()


def build_service(settings: Settings) -> Service:
    """Read the bundle, open the device and show the first mask; or read a recording.

    Raises:
        StartError: whatever stands in the way, in one line.
    """
    if settings.replay is not None:
        return replay_service(settings, settings.replay)
    faults: list[ProblemError] = []
    try:
        with ExitStack() as undo:
            # First of all: it keeps other daemons off the state.
            held = HeldDirectory(settings.state_dir)
            undo.callback(held.close)
            bundle = read_bundle(settings.bundle)
            key = DeviceKey.open(settings.state_dir, faults.append)
            receivers = ReceiverStore(settings.state_dir, faults.append)
            terms = release_terms(settings, bundle, receivers)
            budget = ReleaseBudget(settings.state_dir, settings.raw_budget, faults.append)
            signed = open_calibration(settings, bundle, key, faults.append)
            owners = Owners.open(settings.owner_keys)
            opener = Opener(
                bundle,
                source_opener(settings, signed),
                owners,
                HidingCheck(allow=settings.allow_visible),
            )
            store = BundleStore(
                settings.state_dir / "bundles", settings.bundle, bundle.digest, faults.append
            )
            keys = last_good(store, opener, bundle, faults.append, allow_older=settings.allow_older)
            policies = PolicyStore(settings.state_dir, settings.rotation, faults.append)
            device = open_device(settings, bundle)
            undo.callback(device.close)
            preparation = Preparation(keys.source, key, terms, budget)
            undo.callback(preparation.close)
            camera = MaskedCamera(
                device,
                preparation,
                bundle.measurement_shape,
                OpticalSelfTest(
                    *(bundle.camera, bundle.scene, bundle.embedding), colour=bundle.channels == 3
                ),
                fence=Fence(settle_time(settings, signed), settings.capture_timeout),
                policy=policies.at_start(
                    rotation_policy(settings, bundle),
                    renewable=keys.source.renewable,
                    configured=keys.info.digest == bundle.digest,
                ),
                checks=Checks(settings.self_test_every, settings.guard, bundle.camera.panel.levels),
                calibration=signed,
            )
            undo.pop_all()
            undo.callback(held.close)
            undo.callback(camera.stop)
            watch = open_watch(settings, signed, faults.append)
            _begin(camera, watch.rests)
            undo.pop_all()
    except (
        *(BundleError, BundleRefusedError, BundleOlderError),
        *(DeviceError, RotationImpossibleError),
    ) as error:
        raise StartError(str(error)) from error
    note_start(store, opener, keys, faults.append)
    return Service(
        camera,
        Identity(
            DeviceInfo(
                display=device.display.name,
                sensor=device.sensor.name,
                simulated=device.simulated,
                key=key.public,
            ),
            keys.info,
            experiment="wrong-classifier" if settings.wrong_classifier else None,
        ),
        BundleManager(store, opener, keys),
        CalibrationService(settings, bundle, key, signed),
        form=lambda: terms().form,
        raw_budget=settings.raw_budget,
        pairing=Pairing(receivers, key.public, camera.renew),
        queue_limit=settings.queue,
        heartbeat=settings.heartbeat,
        scenes=device.scenes if settings.scene_api else None,
        break_device=device.set_faults if settings.scene_api else None,
        faults=faults,
        policies=policies,
        capture_log=CaptureLog.of(settings.state_dir, key),
        watch=watch,
        held=held,
    )


def _begin(camera: MaskedCamera, rests: str | None) -> None:
    """Test the panel and show the first mask; or be opaque, and test nothing, for a reason.

    What stands in the way of that is no reason to end: in a dark room nothing can be told before
    there is light, and a cable can be put back. The state says why no capture is taken, and it is
    tried again.
    """
    try:
        if rests is None:
            camera.rotate()
        else:
            camera.rest(rests)
    except ProblemError as error:
        log.warning("no capture yet", reason=str(error), remedy=error.remedy)
    except Exception as error:
        log_defect(error, during="first self test")


class _Server(GateServer):
    """Says when it listens, and ends event streams before connections."""

    def __init__(
        self,
        config: uvicorn.Config,
        connections: Connections,
        service: Service,
        on_listening: Callable[[], None],
    ) -> None:
        super().__init__(config, connections)
        self._service, self._on_listening = service, on_listening

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started:
            self._on_listening()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        notify("STOPPING=1")
        self._service.end_streams()
        await super().shutdown(sockets)


def serve(settings: Settings, on_listening: Callable[[str], None]) -> None:
    """Serve until told to stop, then show opaque.

    Args:
        settings: checked.
        on_listening: called with every URL once requests are answered.

    Raises:
        StartError: the daemon cannot start; nothing else on this machine was disturbed.
    """
    forbid_core_files()
    # The default would end the process at once and leave the mask on the panel.
    default = signal.signal(signal.SIGTERM, _exit)
    try:
        with open_listeners(settings) as listeners:
            _serve(settings, listeners, on_listening)
    finally:
        signal.signal(signal.SIGTERM, default)


def _serve(
    settings: Settings, listeners: list[Listener], on_listening: Callable[[str], None]
) -> None:
    urls = [listener.url for listener in listeners]

    def listening() -> None:
        notify("READY=1")
        for url in urls:
            on_listening(url)

    tls = None
    if settings.tls_certificate is not None and settings.tls_key is not None:
        tls = server_context(settings.tls_certificate, settings.tls_key)
    with no_garbage():
        service = build_service(settings)
    try:
        with open_admission(settings, service.report) as admission:
            room = room_for(settings.connections)
            connections = Connections(*room, run=admission.keys.run)
            config = uvicorn.Config(
                create_app(
                    service,
                    admission,
                    connections,
                    lambda: examine_beside(Machine(), settings),
                ),
                http="h11",
                log_config=None,
                access_log=False,
                # An upgrade is asked like anything else, and refused by the application.
                ws="none",
                server_header=False,
                # Whoever is on this machine could be anybody by naming another address.
                proxy_headers=False,
                timeout_graceful_shutdown=10,
                ssl_context_factory=None if tls is None else lambda *_: tls,
            )
            server = _Server(config, connections, service, listening)
            log.info(
                "start",
                urls=urls,
                device=settings.device if settings.replay is None else "replay",
                auth=settings.auth,
            )
            if settings.auth == "none":
                log.warning("no tokens wanted: whoever reaches this daemon may use it", urls=urls)
            server.run([listener.socket for listener in listeners])
    finally:
        service.stop()


def _exit(*_: object) -> None:
    raise SystemExit(0)
