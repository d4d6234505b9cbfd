"""What a process can do where it runs: one JSON object of attempts, true or why not.

Everything that is tried here an ordinary user may do: files and devices that stand in the way were
opened to all, so that it is the sandbox that refuses, or nobody.
"""

from __future__ import annotations

import ctypes
import json
import mmap
import os
import resource
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

OPEN_FOLDERS = tuple(
    Path(parent) / "open-to-all"
    for parent in ("/etc", "/var/lib/veilcam-release", "/usr", "/usr/lib", "/var/lib", "/srv")
)
OPEN_DEVICES = (Path("/dev/vda"), Path("/dev/ttyS3"), Path("/dev/fuse"))
OTHERS = (Path("/home/open-to-all"), Path("/tmp/open-to-all"))
SCRATCH = (Path("/tmp"), Path("/var/tmp"), Path("/dev/shm"))
PORT = 4711
_NEW_USER, _NO_RANDOM_ADDRESSES = 0x10000000, 0x0040000

_libc = ctypes.CDLL(None, use_errno=True)


def attempts(state: Path) -> dict[str, Callable[[], object]]:
    return {
        **{f"write to {folder}": partial(_write, folder) for folder in OPEN_FOLDERS},
        **{f"open {device}": partial(_open, device) for device in OPEN_DEVICES},
        **{f"look into {folder.parent}": folder.read_text for folder in OTHERS},
        **{
            f"run a file it wrote to {name}": partial(_run_copy, folder)
            for name, folder in (("its state", state), *((str(one), one) for one in SCRATCH))
        },
        "open an internet socket": lambda: socket.socket(socket.AF_INET).close(),
        "call another program's port": _call,
        "see other users' processes": lambda: Path("/proc/1/status").read_text(),
        "make memory that is written and executed": _written_and_executed,
        "make a name space": lambda: _system("unshare", _NEW_USER),
        "change its personality": lambda: _system("personality", _NO_RANDOM_ADDRESSES),
        "make a setuid file": lambda: _setuid(state),
        "change its priority": lambda: os.setpriority(os.PRIO_PROCESS, 0, 5),
        "dump core": _dump_core,
    }


def needs(state: Path) -> dict[str, Callable[[], object]]:
    return {
        "write to its state": lambda: _write(state),
        "draw a key and seal it to a receiver": _seal,
        "open the panel's bus": lambda: os.close(os.open("/dev/spidev0.0", os.O_RDWR)),
        "open a GPIO chip": lambda: os.close(os.open("/dev/gpiochip0", os.O_RDWR)),
        "open a unix socket": lambda: socket.socket(socket.AF_UNIX).close(),
        "ask for devices over netlink": lambda: socket.socket(
            socket.AF_NETLINK, socket.SOCK_RAW
        ).close(),
        "classify with convolutions": _convolve,
    }


def _write(folder: Path) -> None:
    path = folder / f"probe-{os.getpid()}"
    path.write_text("x")
    path.unlink()


def _open(device: Path) -> None:
    os.close(os.open(device, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY))


def _run_copy(state: Path) -> None:
    copy = state / "copy"
    try:
        shutil.copy("/bin/true", copy)
        subprocess.run([copy], check=True)
    finally:
        copy.unlink(missing_ok=True)


def _call() -> None:
    socket.create_connection(("127.0.0.1", PORT), 5).close()


def _written_and_executed() -> None:
    everything = mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC
    mmap.mmap(-1, mmap.PAGESIZE, prot=everything).close()


def _system(name: str, argument: int) -> None:
    if getattr(_libc, name)(ctypes.c_ulong(argument)) == -1:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _setuid(state: Path) -> None:
    path = state / "setuid"
    try:
        path.touch()
        path.chmod(0o4700)
    finally:
        path.unlink(missing_ok=True)


def _dump_core() -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (1024, 1024))


def _seal() -> None:
    from veilcam_client.keys.epoch_key import EpochKey
    from veilcam_client.keys.receivers import ReceiverKey

    key = EpochKey.generate(device="d7" * 32, bundle="0f" * 32)
    ReceiverKey.generate().public.seal(key.reveal(), b"probe")


def _convolve() -> None:
    import torch

    from veilcam_server.devices.simulated.light import use_torch_sparingly

    use_torch_sparingly()
    torch.nn.Conv2d(1, 8, 5)(torch.ones(1, 1, 24, 32))


def _outcome(attempt: Callable[[], object]) -> bool | str:
    try:
        attempt()
    except (OSError, ValueError, RuntimeError, KeyError) as error:
        return f"{type(error).__name__}: {error}"
    return True


def main() -> None:
    """Try what the first argument says, with the folder of the second one as state."""
    which, state = {"attempts": attempts, "needs": needs}, Path(sys.argv[2])
    found = {
        name: {what: _outcome(act) for what, act in which[name](state).items()}
        for name in sys.argv[1].split(",")
    }
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
