"""Files of a run: private ones behind a checksum, and places tried before the work."""

import hashlib
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryDirectory

from veilcam_optics.files import write_whole
from veilcam_training.errors import TrainingError, require

DIGEST_BYTES = hashlib.sha256().digest_size


def write_private(path: Path, content: bytes) -> None:
    """Write ``content`` behind its SHA-256; ``path`` holds what it held before, or all of it.

    A folder that is missing is made for its owner alone.
    """
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    _remove_stale(path)
    write_whole(path, hashlib.sha256(content).digest() + content, private=True)


def read_private(path: Path) -> bytes | None:
    """Return the contents of a file of :func:`write_private`, or None where there is none.

    Raises:
        TrainingError: it cannot be read, is damaged or truncated, or is no such file.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise unreadable(path, str(error.strerror)) from None
    digest, content = data[:DIGEST_BYTES], data[DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        raise unreadable(path, "damaged or truncated")
    return content


def unreadable(path: Path, reason: str) -> TrainingError:
    """Say why a run cannot be taken up from a file."""
    return TrainingError(f"{path} cannot be read ({reason}): remove it to start again")


def _remove_stale(path: Path) -> None:
    """Remove what writers left who were killed; one that had our number is dead, too."""
    for file in path.parent.iterdir():
        match = re.fullmatch(rf"\.{re.escape(path.name)}\.(\d{{1,9}})\.[0-9a-f]{{8}}", file.name)
        if match is not None and not _is_other_process(int(match[1])):
            file.unlink(missing_ok=True)


def _is_other_process(number: int) -> bool:
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # it lives, and is another user's
        return True
    return number != os.getpid()


def check_file(option: str, path: Path, ending: str) -> None:
    """Refuse a place where no file can be written; nothing is left there.

    Raises:
        TrainingError: a name with another ending, a folder, or a place that cannot be written to.
    """
    require(
        path.suffix == ending, f"{option} {path} is not valid: use a name that ends in {ending}"
    )
    with _tried(option, path):
        require(
            not path.is_dir(), f"{option} {path} is not valid: that is a folder, use another name"
        )
        require(
            path.parent.is_dir(),
            f"{option} {path} is not valid: make the folder {path.parent} first",
        )
        # Written, as permissions do not tell: in /proc even root can make nothing.
        NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.").close()


def check_folder(option: str, path: Path) -> None:
    """Refuse a place where no folder can be made or written to; nothing is left there.

    Raises:
        TrainingError: a file, or a place that cannot be written to.
    """
    whole = Path(os.path.abspath(path))
    there = next(folder for folder in (whole, *whole.parents) if os.path.lexists(folder))
    with _tried(option, path), TemporaryDirectory(dir=there, prefix=".veilcam.") as trial:
        (Path(trial) / whole.relative_to(there)).mkdir(parents=True, exist_ok=True)


@contextmanager
def _tried(option: str, path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise TrainingError(
            f"{option} {path} cannot be written to ({error.strerror}): use another place"
        ) from None
