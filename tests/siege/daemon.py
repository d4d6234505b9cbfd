"""Daemons under siege: processes of their own, forked from one that has loaded everything."""

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
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from tests.siege.client import Address

from veilcam_server.errors import StartError
from veilcam_server.settings import Settings
from veilcam_server.system import logs

FILES = 1024
START_LIMIT = 300.0
"""Longest wait for a daemon to listen [s]: ten of work, on a machine that has others to do."""
_CLONE_NEWNS, _CLONE_NEWUSER = 0x0002_0000, 0x1000_0000
_MS_REC, _MS_PRIVATE = 0x4000, 0x4_0000

FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(
    [
        *("tests.siege.clock", "veilcam_server.daemon", "veilcam_server.devices.simulated.device"),
        "tests.siege.attacker",
    ]
)


@contextmanager
def child(target: Callable[..., None], *given: object) -> Iterator[tuple[BaseProcess, Connection]]:
    hear, tell = FORKS.Pipe(duplex=False)
    process = FORKS.Process(target=target, args=(tell, *given))
    process.start()
    tell.close()
    try:
        yield process, hear
    finally:
        process.kill()
        process.join()
        hear.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class Circumstances:
    log: Path | None = None
    disk: int | None = None
    full: bool = False
    clock: Synchronized[float] | None = None


class NoDiskError(StartError):
    """This machine gives no disk of one's own."""


@dataclass
class Daemon:
    address: Address
    state: Path
    log: Path
    process: BaseProcess = field(repr=False)

    def kill(self) -> None:
        self.process.kill()
        self.process.join()

    def resident(self) -> float:
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.partition("VmRSS:")[2].split()[0]) / 1000


@contextmanager
def started(serve: str, settings: Settings, around: Circumstances) -> Iterator[Daemon]:
    log = around.log or settings.state_dir.with_name("veilcamd.log")
    with child(_live, serve, settings, around, log) as (process, told):
        try:
            url = told.recv() if told.poll(START_LIMIT) else StartError("it does not listen")
        except EOFError:
            url = StartError("it ended without a word")
        if isinstance(url, StartError):
            raise url
        certificate = settings.tls_certificate
        inside = Path(f"/proc/{process.pid}/root" if around.disk else "/")
        try:
            yield Daemon(
                Address(url, None if certificate is None else str(certificate)),
                inside / settings.state_dir.relative_to("/"),
                inside / log.relative_to("/"),
                process,
            )
        finally:
            process.terminate()
            process.join(20)


def _live(
    tell: Connection, serve: str, settings: Settings, around: Circumstances, log: Path
) -> None:
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (FILES, hard))
    try:
        if around.disk is not None:
            _mount(settings.state_dir.parent, around.disk)
            if around.full:
                fill(settings.state_dir.parent)
        descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        os.dup2(descriptor, sys.stdout.fileno())
        os.dup2(descriptor, sys.stderr.fileno())
        from tests.siege import clock  # here alone: it replaces the clock of whoever loads it

        clock.shift = around.clock
        logs.configure(settings.log_level)
        run: Any = pkgutil.resolve_name(serve)
        run(settings, tell.send)
    except NoDiskError as error:
        tell.send(error)
    except StartError as error:
        tell.send(StartError(str(error)))


def _mount(folder: Path, size: int) -> None:
    """Mount a disk of ``size`` bytes over ``folder``, with its content, that this process sees."""
    library, user, group = ctypes.CDLL(None, use_errno=True), os.getuid(), os.getgid()
    held = folder.with_name(f"{folder.name}-before")
    try:
        _check(library.unshare(_CLONE_NEWNS | (_CLONE_NEWUSER if user else 0)))
        if user:
            Path("/proc/self/uid_map").write_text(f"0 {user} 1")
            Path("/proc/self/setgroups").write_text("deny")
            Path("/proc/self/gid_map").write_text(f"0 {group} 1")
        _check(library.mount(b"none", b"/", None, _MS_REC | _MS_PRIVATE, None))
        shutil.copytree(folder, held, dirs_exist_ok=True)
        options = f"size={size},mode=0700".encode()
        _check(library.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", 0, options))
        shutil.copytree(held, folder, dirs_exist_ok=True)
        shutil.rmtree(held)
    except OSError as error:
        raise NoDiskError(f"no disk of one's own on this machine ({error.strerror})") from None


def _check(result: int) -> None:
    if result != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def fill(folder: Path) -> Path:
    ballast = folder / "ballast"
    for block in (65_536, 64):
        with suppress(OSError), ballast.open("ab", buffering=0) as stream:
            while True:
                stream.write(bytes(block))
    return ballast


def write_certificate(folder: Path) -> dict[str, Path]:
    """Write a certificate of 127.0.0.1 for a day and its key; return the settings of both."""
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
    pem, private = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    paths = {"tls_certificate": folder / "certificate.pem", "tls_key": folder / "key.pem"}
    paths["tls_certificate"].write_bytes(certificate.public_bytes(pem))
    paths["tls_key"].write_bytes(key.private_bytes(pem, private, serialization.NoEncryption()))
    return paths
