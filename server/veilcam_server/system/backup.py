"""Backups of a state folder: one archive that moves it to a new card; and the folder's end."""

from __future__ import annotations

import os
import shutil
import tarfile
from contextlib import closing
from hashlib import sha256
from pathlib import Path
from typing import BinaryIO

from veilcam_optics.files import sync_folder
from veilcam_server.errors import StartError
from veilcam_server.system.state_file import HeldDirectory, make_directory
from veilcam_server.system.state_folder import (
    is_state_name,
    open_file,
    state_files,
    unreadable,
    unusable,
)

_DIGEST = 32
"""Bytes of the SHA-256 at the end of a backup."""
_CHUNK = 2**20
_STAGED = ".restoring"


def write_backup(directory: Path, stream: BinaryIO) -> int:
    """Write a state folder to a new file, durably, and return its number of files.

    A backup is a tar archive, followed by its SHA-256.

    Args:
        directory: state folder that no daemon uses.
        stream: new file, opened for writing and reading.

    Raises:
        StartError: there is no state, a daemon uses it, or it cannot be read.
        OSError: the file cannot be written.
    """
    names = _state_names(directory)
    with closing(HeldDirectory(directory)):
        with tarfile.open(fileobj=stream, mode="w", format=tarfile.PAX_FORMAT) as archive:
            for name in names:
                try:
                    descriptor = open_file(directory / name, os.O_RDONLY)
                except OSError as error:
                    raise unreadable(error, directory) from None
                with os.fdopen(descriptor, "rb") as content:
                    member = tarfile.TarInfo(name)
                    member.mode, member.size = 0o600, os.fstat(descriptor).st_size
                    archive.addfile(member, content)
        stream.write(_digest(stream, stream.seek(0, os.SEEK_END)))
        stream.flush()
        os.fsync(stream.fileno())
    return len(names)


def restore_backup(stream: BinaryIO, directory: Path) -> int:
    """Write a backup into an empty state folder, and return its number of files.

    The backup is checked whole before anything is written. Files get their names once all of them
    are on the disk.

    Args:
        stream: file of a backup, opened for reading.
        directory: state folder; made if it is not there.

    Raises:
        StartError: the backup is damaged, the folder is not empty or cannot be used, or a daemon
            uses it.
    """
    names = _checked(stream)
    with closing(HeldDirectory(directory)):
        staged = directory / _STAGED
        shutil.rmtree(staged, ignore_errors=True)
        if any(directory.iterdir()):
            raise StartError(
                f"{directory} is not empty: move what is in it away, or give another --state-dir"
            )
        try:
            _extract(stream, staged)
            for name in names:
                make_directory((directory / name).parent)
                (staged / name).rename(directory / name)
                sync_folder((directory / name).parent)
        except OSError as error:
            for name in names:
                (directory / name).unlink(missing_ok=True)
            raise unusable(directory, error) from None
        finally:
            shutil.rmtree(staged, ignore_errors=True)
    return len(names)


def wipe_state(directory: Path) -> tuple[str, ...]:
    """Overwrite and remove all files of a state folder, and return the names of what is left.

    Args:
        directory: state folder that no daemon uses.

    Raises:
        StartError: there is no state, a daemon uses it, or the disk refuses.
    """
    names = _state_names(directory)
    with closing(HeldDirectory(directory)):
        try:
            for name in names:
                _overwrite(directory / name)
            for name in names:
                (directory / name).unlink()
            for folder in {(directory / name).parent for name in names} - {directory}:
                if not any(folder.iterdir()):
                    folder.rmdir()
            sync_folder(directory)
        except OSError as error:
            raise unusable(directory, error) from None
    return tuple(sorted(os.listdir(directory)))


def _state_names(directory: Path) -> tuple[str, ...]:
    try:
        names = state_files(directory)
    except OSError as error:
        raise unusable(directory, error) from None
    if not names:
        raise StartError(f"{directory} holds no state: give another --state-dir")
    return names


def _digest(stream: BinaryIO, size: int) -> bytes:
    """Return the SHA-256 of the first bytes of a stream, which is read up to their end."""
    digest, left = sha256(), size
    stream.seek(0)
    while chunk := stream.read(min(left, _CHUNK)):
        digest.update(chunk)
        left -= len(chunk)
    return digest.digest()


def _checked(stream: BinaryIO) -> tuple[str, ...]:
    """Return the names in a whole backup, none of which leads out of a state folder."""
    size = stream.seek(0, os.SEEK_END) - _DIGEST
    if size < 0 or _digest(stream, size) != stream.read():
        raise StartError("the backup is damaged or cut off, or none: nothing was written")
    stream.seek(0)
    try:
        with tarfile.open(fileobj=stream, mode="r:") as archive:
            members = archive.getmembers()
    except tarfile.TarError as error:
        raise StartError(f"the backup cannot be read ({error}): nothing was written") from None
    names = tuple(member.name for member in members)
    if not all(member.isreg() and is_state_name(member.name) for member in members):
        raise StartError("the backup holds what is no state: nothing was written")
    if len(set(names)) < len(names):
        raise StartError("the backup holds a file twice: nothing was written")
    return names


def _extract(stream: BinaryIO, folder: Path) -> None:
    stream.seek(0)
    with tarfile.open(fileobj=stream, mode="r:") as archive:
        for member in archive:
            path, content = folder / member.name, archive.extractfile(member)
            if content is None:
                continue
            make_directory(path.parent)
            descriptor = open_file(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
            with os.fdopen(descriptor, "wb") as out:
                shutil.copyfileobj(content, out)
                out.flush()
                os.fsync(descriptor)


def _overwrite(path: Path) -> None:
    """Write random bytes over a file, through to the disk."""
    descriptor = open_file(path, os.O_WRONLY)
    with os.fdopen(descriptor, "wb") as stream:
        left = os.fstat(descriptor).st_size
        while left > 0:
            left -= stream.write(os.urandom(min(left, _CHUNK)))
        stream.flush()
        os.fsync(descriptor)
