"""State folder: owner, permissions, and files in it that cannot be read.

A file that cannot be read is not damaged. It stays where it is, and whoever needs it is told whose
it is and which command mends that.
"""

from __future__ import annotations

import errno
import grp
import os
import pwd
import re
import shlex
import stat
from collections.abc import Iterator
from pathlib import Path

from veilcam_server.errors import StartError

_FILE = re.compile(
    r"[a-z-]+\.json(\.copy)?|[a-z-]+\.json\.lock|\d+\.jsonl"
    r"|[0-9a-f]{64}\.veilcam|scene\.npy"
)
"""Names of state files, each of which has to be a regular file."""
_FOLDERS = ("bundles", "log")
"""Folders within the state folder."""
_STATE = re.compile(
    rf"(?:{_FILE.pattern})(?:\.damaged|\.new)?|(?:bundles|log(?:\.damaged)?)/[\w-][\w.-]*",
    re.ASCII,
)
"""Names of all files of a state folder, as paths in it."""
_NO_FILE = (*(errno.EEXIST, errno.EINVAL, errno.EISDIR, errno.ELOOP, errno.ENOTDIR, errno.ENXIO),)
"""Errors of what is neither file nor folder where there has to be one."""
_SIGNS = ("device-key.json", "tokens.json", "scene.npy")
"""Files of which at least one is in a state folder that was used."""


def become_owner(directory: Path) -> None:
    """Take on user and groups of a state folder's owner, for good, where this is root.

    A folder that is not there yet belongs to the owner of the nearest folder above it. Whatever
    root makes in the folder then belongs to the daemon's user.

    Raises:
        StartError: the folder's owner cannot be told.
    """
    if os.geteuid() != 0:
        return
    directory = directory.absolute()
    try:
        found = next(
            path for path in (directory, *directory.parents) if os.path.lexists(path)
        ).stat()
    except OSError as error:
        raise unusable(directory, error) from None
    if found.st_uid == 0:
        return
    try:
        user = pwd.getpwuid(found.st_uid)
    except KeyError:  # of a container, or of a service that is not running
        os.setgroups([])
    else:
        os.initgroups(user.pw_name, found.st_gid)
    os.setresgid(found.st_gid, found.st_gid, found.st_gid)
    os.setresuid(found.st_uid, found.st_uid, found.st_uid)


def require_usable(directory: Path) -> None:
    """Refuse a state folder in which something cannot be read; keep others out of it.

    A folder that others may look into becomes its owner's alone. One that is not there is not made.

    Raises:
        StartError: the file or folder, its owner, and the command that mends it.
    """
    try:
        _keep_private(directory)
    except FileNotFoundError:
        return
    except OSError as error:
        raise unusable(directory, error) from None
    require_readable(directory)


def require_readable(directory: Path) -> None:
    """Refuse a state folder in which something cannot be read; change nothing.

    Raises:
        StartError: as :func:`require_usable`.
    """
    try:
        for path in _entries(directory):
            _require_readable(path)
    except FileNotFoundError:
        return
    except OSError as error:
        raise unreadable(error, directory) from None


def is_state_name(name: str) -> bool:
    """Return whether ``name`` is a path, in a state folder, of a file of the state."""
    return _STATE.fullmatch(name) is not None


def state_files(directory: Path) -> tuple[str, ...]:
    """Return the paths of all files of the state, in a state folder; raises :class:`OSError`."""
    paths = [path for pattern in ("*", "*/*") for path in directory.glob(pattern) if path.is_file()]
    names = (path.relative_to(directory).as_posix() for path in paths)
    return tuple(sorted(filter(is_state_name, names)))


def open_file(path: Path, flags: int) -> int:
    """Open a state file for its owner alone, without waiting for what is none.

    Args:
        path: path of a regular file.
        flags: flags of :func:`os.open`.

    Raises:
        OSError: it cannot be opened, or is a folder, a FIFO, a socket or a device.
    """
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC, 0o600)
    try:
        _require_regular(path, os.fstat(descriptor).st_mode)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def read_file(path: Path, limit: int = -1) -> bytes:
    """Return what a state file holds; raises :class:`OSError` as :func:`open_file`.

    Args:
        path: path of a regular file.
        limit: greatest number of bytes to read; -1: all.
    """
    try:
        with os.fdopen(open_file(path, os.O_RDONLY), "rb") as stream:
            return stream.read(limit)
    except OSError as error:
        # A disk that fails does not say where.
        raise OSError(error.errno, error.strerror, str(path)) from None


def unreadable(error: OSError, directory: Path) -> StartError:
    """Return what is said of something in a state folder that cannot be read.

    Args:
        error: error with the path.
        directory: the state folder.
    """
    path = Path(str(error.filename or directory))
    return StartError(
        f"{path} cannot be read ({error.strerror}){_owner(path)}: {_remedy(path, directory, error)}"
    )


def unusable(directory: Path, error: OSError) -> StartError:
    """Return what is said of a state folder that cannot be used."""
    return StartError(
        f"{directory} cannot be used ({error.strerror}){_owner(directory)}: "
        f"{_remedy(directory, directory, error)}, or give another --state-dir"
    )


def _keep_private(directory: Path) -> None:
    found = directory.stat()
    mode = stat.S_IMODE(found.st_mode)
    if not stat.S_ISDIR(found.st_mode):
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(directory))
    if mode & 0o777 == 0o700:
        return
    if found.st_uid == os.geteuid() and _is_state(directory, mode):
        directory.chmod(0o700)
    elif mode & 0o077:
        raise StartError(
            f"{directory} may be used by others ({mode:04o}){_owner(directory)}: give a folder of "
            f"its own, or run '{_chown(directory)}' and 'sudo chmod 700 {_quoted(directory)}'"
        )


def _is_state(directory: Path, mode: int) -> bool:
    """Return whether a folder is for state alone: not a home or ``/tmp`` named by error."""
    if mode & stat.S_ISVTX:
        return False
    names = set(os.listdir(directory))
    return not names or not names.isdisjoint(_SIGNS)


def _entries(directory: Path) -> Iterator[Path]:
    for path in sorted(directory.iterdir()):
        yield path
        if path.name in _FOLDERS and path.is_dir():
            yield from sorted(path.iterdir())


def _require_readable(path: Path) -> None:
    try:
        mode = path.stat().st_mode
        if path.name in _FOLDERS:
            if not stat.S_ISDIR(mode):
                raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))
        elif _FILE.fullmatch(path.name):
            _require_regular(path, mode)
            os.close(open_file(path, os.O_RDONLY))
        elif not (stat.S_ISDIR(mode) or stat.S_ISSOCK(mode)):  # a daemon may listen there
            _require_regular(path, mode)
    except FileNotFoundError:  # another process was quicker, or a link leads nowhere
        pass


def _require_regular(path: Path, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "Not a regular file", str(path))


def _owner(path: Path) -> str:
    """Owner of a file in words, where it is another user than this one."""
    try:
        owner = path.stat().st_uid
    except OSError:
        return ""
    return "" if owner == os.geteuid() else f", it belongs to {_user(owner)}"


def _remedy(path: Path, directory: Path, error: OSError) -> str:
    if error.errno not in (errno.EACCES, errno.EPERM):
        return "move it away" if error.errno in _NO_FILE else "check the disk"
    if _owner(directory) and directory.stat().st_uid != 0:
        return f"run it as that user, or '{_chown(directory)}'"
    if _owner(path):
        return f"run '{_chown(directory)}'"
    return f"run 'sudo chmod -R u+rwX {_quoted(directory)}'"


def _chown(directory: Path) -> str:
    return f"sudo chown -R {_user(os.geteuid())}:{_group(os.getegid())} {_quoted(directory)}"


def _quoted(path: Path) -> str:
    return shlex.quote(str(path))


def _user(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return str(number)


def _group(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)
