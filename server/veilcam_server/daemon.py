"""Daemon from its settings: every reason not to start is one :class:`StartError`."""

from __future__ import annotations

import signal
import socket
import ssl
from asyncio.sslproto import SSLProtocol
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import structlog
import uvicorn

from veilcam_server.api.app import create_app
from veilcam_server.devices.errors import DeviceError
from veilcam_server.doctor.checkup import examine_beside
from veilcam_server.doctor.machine import Machine
from veilcam_server.errors import (
    BundleOlderError,
    BundleRefusedError,
    RotationImpossibleError,
    StartError,
    StorageError,
)
from veilcam_server.gate.protocol import Connections
from veilcam_server.gate.server import GateServer
from veilcam_server.security.admission import open_admission
from veilcam_server.service.replay import replayed_camera
from veilcam_server.service.served_camera import ServedCamera
from veilcam_server.service.service import Service
from veilcam_server.service.state import State
from veilcam_server.settings import Settings
from veilcam_server.system.listeners import (
    Listener,
    Listening,
    listening_record,
    open_listeners,
    room_for,
)
from veilcam_server.system.memory import forbid_core_files, no_garbage
from veilcam_server.system.systemd import notify
from veilcam_training.bundle import BundleError

log = structlog.get_logger()


_READ_AT_ONCE = 32 * 1024
"""From a connection, all connections of this process [bytes]."""


def server_context(certificate: Path, key: Path) -> ssl.SSLContext:
    """Return a context of TLS 1.2 or later with this certificate.

    Args:
        certificate: PEM file, with the certificates between it and the authority.
        key: PEM file of its private key, without a passphrase.

    Raises:
        StartError: one of them cannot be used; no message repeats what is in it.
    """
    # asyncio fills 256 KiB of memory for whatever a connection may send at once, so that 200 that
    # never speak would take 50 MB. A record of TLS has 16 KiB (RFC 8446, 5.1).
    SSLProtocol.max_size = _READ_AT_ONCE
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    for option, path in (("--tls-certificate", certificate), ("--tls-key", key)):
        try:
            path.open("rb").close()
        except OSError as error:
            raise StartError(
                f"{option}: {path} cannot be read ({error.strerror}): check it"
            ) from None
    try:
        # A passphrase would be asked for on the terminal, where nobody sits.
        context.load_cert_chain(certificate, key, password=_no_passphrase)
    except (ssl.SSLError, StartError) as error:
        reason = getattr(error, "reason", None) or str(error)
        raise StartError(
            f"--tls-certificate and --tls-key cannot be used ({reason}): give a certificate and "
            "the key it was made for, both as PEM"
        ) from None
    return context


def certificate_digest(path: Path) -> bytes:
    """Return the SHA-256 of the first certificate of a PEM file that a server uses."""
    # Late: it takes long to load, and most daemons serve plain HTTP.
    from cryptography.hazmat.primitives.hashes import SHA256  # noqa: PLC0415
    from cryptography.x509 import load_pem_x509_certificates  # noqa: PLC0415

    return load_pem_x509_certificates(path.read_bytes())[0].fingerprint(SHA256())


def _no_passphrase() -> str:
    raise StartError("the key has a passphrase")


def build_service(settings: Settings) -> Service:
    """Read the bundle, open the device and show the first mask; or read a recording.

    Raises:
        StartError: whatever stands in the way, in one line.
    """
    # First of all: it keeps other daemons off the state.
    state = State.open(settings.state_dir)
    with ExitStack() as undo:
        undo.callback(state.close)
        try:
            if settings.replay is None:
                camera = ServedCamera.open(settings, state)
            else:
                camera = replayed_camera(settings, settings.replay)
        except (
            *(BundleError, BundleRefusedError, BundleOlderError),
            *(DeviceError, RotationImpossibleError),
        ) as error:
            raise StartError(str(error)) from error
        undo.pop_all()
    return Service(camera, state, queue_limit=settings.queue)


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

    tls = certificate = None
    if settings.tls_certificate is not None and settings.tls_key is not None:
        tls = server_context(settings.tls_certificate, settings.tls_key)
        certificate = certificate_digest(settings.tls_certificate)
    with no_garbage():
        service = build_service(settings)
    try:
        with open_admission(settings, service.log, service.report, certificate) as admission:
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
            _record(settings, urls, certificate)
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


def _record(settings: Settings, urls: list[str], certificate: bytes | None) -> None:
    """Record where the daemon listens; a disk that refuses it ends nothing."""
    record = Listening(
        urls=tuple(urls),
        hosts=settings.hosts,
        certificate=None if certificate is None else certificate.hex(),
        pairs=settings.release != "none",
    )
    try:
        listening_record(settings.state_dir).change(lambda _: record)
    except StorageError as error:
        log.warning("'veilcamd pair' does not find this daemon", reason=str(error))


def _exit(*_: object) -> None:
    raise SystemExit(0)
