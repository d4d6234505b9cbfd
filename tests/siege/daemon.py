"""A daemon of one's own: forked from a process that has loaded everything, and told what to do."""

from __future__ import annotations

import ctypes
import datetime
import ipaddress
import multiprocessing
import os
import pkgutil
import resource
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess, SpawnProcess
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import TypeAlias
from urllib.parse import urlsplit

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from tests.siege.client import Address

from veilcam_server.errors import StartError
from veilcam_server.settings import Settings
from veilcam_server.system import logs

Serve: TypeAlias = Callable[[Settings, Callable[[str], None]], None]
"""What ``veilcamd serve`` runs: it tells the URL when it listens, and returns when stopped."""
# This module is imported before a daemon's clock is set, and nothing that looks at a clock may be.

FILES = 1024
"""Files that a process may open unless it asks for more: the soft limit of Debian."""
SIMULATION = "veilcam_server.devices.simulated.device"
"""Module that every daemon of a siege needs, and imports late."""
START_LIMIT = 300.0
"""Longest wait for a daemon to listen [s]: ten of work, on a machine that has others to do."""
DISK = "disk"
"""Folder that a disk of one's own is mounted on, with the state and the log in it."""
_CLONE_NEWNS, _CLONE_NEWUSER = 0x0002_0000, 0x1000_0000
_MS_REC, _MS_PRIVATE = 0x4000, 0x4_0000


@dataclass(frozen=True, slots=True, kw_only=True)
class Circumstances:
    """What a daemon meets on this machine.

    Attributes:
        log: file or device that its log goes to; beside its state by default.
        disk: size of a disk of its own for ``DISK``, which nobody else sees [bytes]; None for none.
        full: fill that disk before the start.
        clock: added to the wall clock [s], at each look: it may jump. Such a daemon starts slowly.
    """

    log: Path | None = None
    disk: int | None = None
    full: bool = False
    clock: Synchronized[float] | None = None


class NoDiskError(StartError):
    """This machine gives no disk of one's own."""


@dataclass
class Daemon:
    """One that runs.

    Attributes:
        address: where it is reached.
        state: its state directory, as this process sees it.
    """

    address: Address
    state: Path
    log: Path
    process: ForkServerProcess | SpawnProcess = field(repr=False)

    @property
    def alive(self) -> bool:
        """Whether it has not ended."""
        return self.process.is_alive()

    def kill(self) -> None:
        """End it at once (SIGKILL)."""
        self.process.kill()
        self.process.join()

    def resident(self) -> float:
        """Its resident memory [MB]."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        [line] = [line for line in status.splitlines() if line.startswith("VmRSS:")]
        return int(line.split()[1]) / 1000

    def logged(self) -> int:
        """What it has written to its log [bytes]."""
        return self.log.stat().st_size


class Launcher:
    """Starts daemons, each in a process of its own under one folder.

    Args:
        serve: name of what a daemon runs, ``module:function``, a :data:`Serve`.
        folder: for their state and logs.
    """

    def __init__(self, serve: str, folder: Path) -> None:
        self._serve, self.folder = serve, folder
        # A fork of a process that has loaded torch and has no thread: a start takes no seconds.
        self._forks = multiprocessing.get_context("forkserver")
        self._anew = multiprocessing.get_context("spawn")
        self._forks.set_forkserver_preload([serve.partition(":")[0], SIMULATION])

    def clock(self) -> Synchronized[float]:
        """What is added to the wall clock of daemons that are given it [s]."""
        return self._forks.Value("d", 0.0)

    def fresh(self, name: str) -> Path:
        """Return a new and empty folder for a row."""
        folder = self.folder / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        return folder

    @contextmanager
    def running(self, settings: Settings, around: Circumstances) -> Iterator[Daemon]:
        """Yield a daemon that listens; end it afterwards.

        Raises:
            StartError: it did not start; the reason is its own.
        """
        told, tell = self._forks.Pipe(duplex=False)
        # Only what is imported later takes another clock: with it, nothing may be loaded before.
        start = (self._forks if around.clock is None else self._anew).Process
        process = start(target=_live, args=(self._serve, settings, around, tell))
        process.start()
        tell.close()
        try:
            url = _url(told)
            inside = Path(f"/proc/{process.pid}/root") if around.disk else Path("/")
            yield Daemon(
                _address(url, settings),
                inside / settings.state_dir.relative_to("/"),
                inside / _log(settings, around).relative_to("/"),
                process,
            )
        finally:
            process.terminate()
            process.join(20)
            if process.is_alive():
                process.kill()
                process.join()
            told.close()


def _log(settings: Settings, around: Circumstances) -> Path:
    return around.log or settings.state_dir.with_name("veilcamd.log")


def _url(told: Connection) -> str:
    """The first word of a daemon; raises :class:`StartError`, with its own reason."""
    if not told.poll(START_LIMIT):
        raise StartError(f"it did not listen within {START_LIMIT:.0f} s")
    try:
        word = told.recv()
    except EOFError:
        raise StartError("it ended without a word") from None
    if isinstance(word, StartError):
        raise word
    return str(word)


def _address(url: str, settings: Settings) -> Address:
    place = urlsplit(url)
    certificate = settings.tls_certificate
    return Address(
        place.hostname or "", place.port or 0, None if certificate is None else str(certificate)
    )


def _live(name: str, settings: Settings, around: Circumstances, tell: Connection) -> None:
    """A daemon's process, from its circumstances to its end."""
    resource.setrlimit(
        resource.RLIMIT_NOFILE, (FILES, resource.getrlimit(resource.RLIMIT_NOFILE)[1])
    )
    try:
        if around.disk is not None:
            _mount(settings.state_dir.parent, around.disk)
            if around.full:
                fill(settings.state_dir.parent)
        log = os.open(_log(settings, around), os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        os.dup2(log, sys.stdout.fileno())
        os.dup2(log, sys.stderr.fileno())
        if around.clock is not None:
            _shift(around.clock)
        logs.configure(settings.log_level)
        serve: Serve = pkgutil.resolve_name(name)
        serve(settings, tell.send)
    except NoDiskError as error:
        tell.send(error)
    except StartError as error:
        tell.send(StartError(str(error)))


def _shift(clock: Synchronized[float]) -> None:
    right = time.time
    time.time = lambda: right() + clock.value


def _mount(folder: Path, size: int) -> None:
    """Mount a disk of ``size`` bytes with what is in ``folder``, that this process alone sees.

    Who may not mount may do so in a name space of users of its own, where the kernel allows that.

    Raises:
        NoDiskError: it does not.
    """
    library, user, group = ctypes.CDLL(None, use_errno=True), os.getuid(), os.getgid()
    held = folder.with_name(f"{folder.name}-before")
    spaces = _CLONE_NEWNS | (_CLONE_NEWUSER if user else 0)
    try:
        _check(library.unshare(spaces))
        if user:
            Path("/proc/self/uid_map").write_text(f"0 {user} 1")
            Path("/proc/self/setgroups").write_text("deny")
            Path("/proc/self/gid_map").write_text(f"0 {group} 1")
        _check(library.mount(b"none", b"/", None, _MS_REC | _MS_PRIVATE, None))
        shutil.copytree(folder, held, dirs_exist_ok=True)
        size_option = f"size={size},mode=0700".encode()
        _check(library.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", 0, size_option))
        shutil.copytree(held, folder, dirs_exist_ok=True)
        shutil.rmtree(held)
    except OSError as error:
        raise NoDiskError(f"no disk of one's own on this machine ({error.strerror})") from None


def _check(result: int) -> None:
    if result != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def fill(folder: Path) -> Path:
    """Take all the room that is left on a folder's disk; return the file that takes it."""
    ballast = folder / "ballast"
    with suppress(OSError), ballast.open("ab", buffering=0) as stream:
        while True:
            stream.write(bytes(65_536))
    # And the rest, byte by byte of a page.
    with suppress(OSError), ballast.open("ab", buffering=0) as stream:
        while True:
            stream.write(b"\0" * 64)
    return ballast


def write_certificate(folder: Path) -> tuple[Path, Path]:
    """Write a certificate of 127.0.0.1 for a day and its key; return both PEM files."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "siege")])
    now, day = datetime.datetime.now(datetime.UTC), datetime.timedelta(days=1)
    own = x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))])
    certificate = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - day)
        .not_valid_after(now + day)
        .add_extension(own, critical=False)
        .sign(key, hashes.SHA256())
    )
    paths = folder / "certificate.pem", folder / "key.pem"
    paths[0].write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    paths[1].write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
    )
    return paths
