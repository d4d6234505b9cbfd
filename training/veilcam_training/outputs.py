"""Places that a command writes to: each is tried before the work, not after it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryDirectory

from veilcam_training.errors import TrainingError


def check_file(option: str, path: Path, ending: str) -> None:
    """Refuse a place where no file can be written; nothing is left there.

    Raises:
        TrainingError: a name with another ending, a folder, or a place that cannot be written to.
    """
    if path.suffix != ending:
        raise TrainingError(f"{option} {path} is not valid: use a name that ends in {ending}")
    with _tried(option, path):
        if path.is_dir():
            raise TrainingError(f"{option} {path} is not valid: that is a folder, use another name")
        if not path.parent.is_dir():
            raise TrainingError(
                f"{option} {path} is not valid: make the folder {path.parent} first"
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
