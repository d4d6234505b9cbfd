"""Listening sockets of the daemon, names of peers, and open files for their connections."""

from __future__ import annotations

import errno
import ipaddress
import os
import re
import resource
import socket
import stat
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import structlog
from pydantic import BaseModel, ConfigDict

from veilcam_server.errors import StartError
from veilcam_server.settings import Settings
from veilcam_server.system.state_file import HeldDirectory, StateStore
from veilcam_server.system.systemd import take_sockets

BACKLOG = 2048
"""Connections that the kernel keeps, and accepted sockets that wait."""
RESERVE = 128
"""Open files that are no connections: state, logs, camera, panel, listening sockets."""

log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class Listener:
    """A listening socket, and where it is reached."""

    socket: socket.socket
    url: str


@contextmanager
def open_listeners(settings: Settings) -> Iterator[list[Listener]]:
    """Listen as long as the context lasts.

    Sockets passed by systemd come before the settings' own, which is then not opened.

    Raises:
        StartError: somebody else listens there, or it is not allowed.
    """
    with ExitStack() as stack:
        passed = [stack.enter_context(one) for one in take_sockets()]
        if passed:
            for one in passed:
                _require_private(one, settings)
            yield [Listener(one, _url(one, settings)) for one in passed]
            return
        listener = stack.enter_context(_bind(settings))
        if settings.socket is not None:
            # What systemd opened is systemd's to remove.
            stack.callback(settings.socket.unlink, missing_ok=True)
        yield [Listener(listener, _url(listener, settings))]


def require_free(settings: Settings) -> None:
    """Raise StartError if somebody else listens where the settings say, and systemd does not."""
    if "LISTEN_FDS" in os.environ:
        return
    _bind(settings).close()
    if settings.socket is not None:
        settings.socket.unlink(missing_ok=True)


def _require_private(passed: socket.socket, settings: Settings) -> None:
    """Refuse the addresses of a socket unit that the settings would refuse."""
    address = passed.getsockname()
    if passed.family == socket.AF_UNIX:
        if not isinstance(address, str):  # bytes: a name without a file, hence without permissions
            raise StartError(
                "systemd passed a socket in the abstract name space, which any user may open: "
                "use ListenStream= with a path"
            )
        if settings.tls_certificate is not None:
            raise StartError(
                f"systemd passed {address}, and a unix socket needs no TLS: leave it out of the "
                "socket unit, or leave --tls-certificate out"
            )
        return
    host = address[0]
    if not ipaddress.ip_address(host).is_loopback and not settings.serves_others:
        raise StartError(
            f"systemd passed a socket on {host}, and other machines are served with TLS and tokens "
            "only: give --tls-certificate, --tls-key and --auth tokens, or use "
            "ListenStream=127.0.0.1:PORT, [::1]:PORT or a path"
        )


def _url(listener: socket.socket, settings: Settings) -> str:
    if listener.family == socket.AF_UNIX:
        return f"unix://{Path(listener.getsockname()).resolve()}"
    host, port = listener.getsockname()[:2]
    scheme = "http" if settings.tls_certificate is None else "https"
    name = f"[{host}]" if listener.family == socket.AF_INET6 else host
    return f"{scheme}://{name}:{port}"


def _bind(settings: Settings) -> socket.socket:
    try:
        if settings.socket is not None:
            return _bind_unix(settings.socket)
        return _bind_tcp(settings.host, settings.port)
    except OSError as error:
        where, option = (
            (f"port {settings.port}", "--port")
            if settings.socket is None
            else (f"socket {settings.socket}", "--socket")
        )
        if error.errno == errno.EADDRINUSE:
            raise StartError(
                f"{where} is occupied: stop what listens there, or give another {option}"
            ) from None
        raise StartError(
            f"cannot listen on {where} ({error.strerror or error}): give another {option}"
        ) from None


def _bind_tcp(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # The protocol is named: asyncio turns Nagle's algorithm off only where it is, and with it
    # on every answer waits 40 ms for an acknowledgement.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(128)
    except BaseException:
        listener.close()
        raise
    return listener


def _bind_unix(path: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        if path.exists():
            if not stat.S_ISSOCK(path.stat().st_mode):
                raise OSError(errno.EEXIST, "there is a file of that name")
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
                if probe.connect_ex(str(path)) == 0:
                    raise OSError(errno.EADDRINUSE, "occupied")
            path.unlink()  # left behind by a daemon that was killed
        listener.bind(str(path))
        path.chmod(0o600)
        listener.listen()
    except BaseException:
        listener.close()
        raise
    return listener


def peer_of(address: object) -> str:
    """Return the name of a peer; a /64 network of IPv6 is one peer.

    Args:
        address: address as ``socket.accept`` returns it.
    """
    if not isinstance(address, tuple):
        return "local socket"
    host = ipaddress.ip_address(address[0].partition("%")[0])
    if isinstance(host, ipaddress.IPv4Address):
        return str(host)
    return str(host.ipv4_mapped or ipaddress.ip_network((host, 64), strict=False))


class Listening(BaseModel):
    """Record of where a daemon is reached, for the commands on its machine."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    urls: tuple[str, ...]
    """URLs that it listens on."""
    hosts: tuple[str, ...]
    """Names that it answers to besides localhost and its addresses."""
    certificate: str | None
    """SHA-256 of the certificate that it serves; None: plain HTTP."""
    pairs: bool
    """False where embeddings never leave."""

    @property
    def place(self) -> str:
        """HOST:PORT that other machines reach, if any does; or the path of a unix socket."""
        url = min(self.urls, key=lambda each: each.startswith("unix:"))
        if url.startswith("unix:"):
            return url.removeprefix("unix://")
        place = url.partition("://")[2]
        host, _, port = place.rpartition(":")
        if not ipaddress.ip_address(host.strip("[]")).is_unspecified:
            return place
        names = (re.sub(r":\d+$", "", name) for name in self.hosts)
        return f"{next(names, None) or _own_address()}:{port}"


def listening_record(directory: Path) -> StateStore[Listening]:
    """Return the store of the record, in a daemon's state directory."""
    return StateStore(directory / "listening.json", Listening, lost="restart the daemon")


def running_daemon(directory: Path) -> Listening:
    """Return where the daemon of a state directory listens.

    Raises:
        StartError: no daemon runs, or it does not listen yet.
    """
    record = listening_record(directory).read() if directory.is_dir() else None
    if record is not None:
        try:
            HeldDirectory(directory).close()
        except StartError:
            return record
    raise StartError(f"no daemon runs in {directory}: start it, or name its --state-dir")


def _own_address() -> str:
    """Return the address of this machine on the way to others; loopback where there is none."""
    for family, far in ((socket.AF_INET, "192.0.2.1"), (socket.AF_INET6, "2001:db8::1")):
        with socket.socket(family, socket.SOCK_DGRAM) as one, suppress(OSError):
            one.connect((far, 9))  # sends nothing
            found = one.getsockname()[0]
            return f"[{found}]" if ":" in found else found
    return "127.0.0.1"


def room_for(connections: int) -> tuple[int, int]:
    """Return the numbers of connections and of waiting sockets that the process has files for.

    This raises the soft limit of open files as far as the hard limit allows.

    Args:
        connections: number of connections that is asked for.
    """
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    soft, hard = (sys.maxsize if one == resource.RLIM_INFINITY else one for one in limits)
    needed = connections + BACKLOG + RESERVE
    if soft < needed:
        soft = min(needed, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, limits[1]))
    free = max(soft - RESERVE, soft // 2)  # of few files, half is for callers
    granted = min(connections, free * 3 // 4)
    if granted < connections:
        log.warning("few files may be open", connections=granted, files=soft)
    return granted, min(BACKLOG, free - granted)
