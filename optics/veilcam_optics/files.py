"""Files that are whole at every moment: what they held before, or all that was written."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO


@contextmanager
def replacing(path: Path, *, private: bool = False) -> Iterator[BinaryIO]:
    """Yield a stream into a neighbour of ``path``, which takes its place once it is on the disk.

    The neighbour's name is that of ``path`` behind a dot, then the number of this process and a
    random one: what a killed writer leaves can be told from what another one is writing.

    Args:
        path: path in a folder that exists.
        private: True: only its owner may read the file; else the umask decides.

    Raises:
        OSError: the disk refuses; ``path`` holds what it held before.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _mode(private=private))
    try:
        with os.fdopen(descriptor, "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def write_whole(path: Path, content: bytes, *, private: bool = False) -> None:
    """Replace ``path`` by ``content``; arguments and errors are those of :func:`replacing`."""
    with replacing(path, private=private) as stream:
        stream.write(content)


def create_private(path: Path, content: bytes) -> None:
    """Write a new file that its owner alone may read, durably.

    Raises:
        FileExistsError: there is such a file already; it is left alone.
        OSError: the disk refuses; there is no file.
    """
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _mode(private=True))
    try:
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        sync_folder(path.parent)
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def sync_folder(folder: Path) -> None:
    """Make durable which names a folder holds."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _mode(*, private: bool) -> int:
    return 0o600 if private else 0o666
