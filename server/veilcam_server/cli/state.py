"""``veilcamd backup``, ``restore`` and ``wipe``: a state folder on its way to a new card."""

from __future__ import annotations

import json as encoder
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from veilcam_server.cli.terminal import USAGE, JsonOption, StateDirOption, enter_state, fail
from veilcam_server.environment import default_state_dir
from veilcam_server.errors import StartError

FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="File of the backup.")]


def backup(
    file: FileArgument, *, state_dir: StateDirOption = None, json: JsonOption = False
) -> None:
    """Write the state of a daemon to a new file, to move it to another card.

    Stop the daemon first. The file holds the device's key and all bundles: keep it as safe as the
    card.
    """
    from veilcam_server.system.backup import write_backup  # noqa: PLC0415 - --help need not wait

    directory = state_dir or default_state_dir()
    if directory.resolve() in file.resolve().parents:
        fail(f"{file} is within the state directory: give a file outside of it", USAGE)
    try:
        # Made by who asks: what root may write, the folder's owner may not.
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        fail(f"{file} cannot be written ({error.strerror}): give the name of a new file", USAGE)
    made = False
    try:
        with os.fdopen(descriptor, "w+b") as stream:
            enter_state(directory)
            count = write_backup(directory, stream)
        made = True
    except StartError as error:
        fail(str(error))
    except OSError as error:
        fail(f"{file} cannot be written ({error.strerror}): make room for it")
    finally:
        if not made:
            with suppress(OSError):
                file.unlink()
    _tell({"files": count, "to": str(file)}, f"wrote {count} files to {file}", json=json)


def restore(
    file: FileArgument, *, state_dir: StateDirOption = None, json: JsonOption = False
) -> None:
    """Write a backup into the empty state directory of a daemon that does not run.

    The backup is checked whole first. Do not start the daemon of the old card again: each card
    would release its own budget of embeddings.
    """
    from veilcam_server.system.backup import restore_backup  # noqa: PLC0415 - --help need not wait

    directory = state_dir or default_state_dir()
    try:
        with file.open("rb") as stream:
            enter_state(directory)
            count = restore_backup(stream, directory)
    except StartError as error:
        fail(str(error))
    except OSError as error:
        fail(f"{file} cannot be read ({error.strerror})", USAGE)
    _tell({"files": count, "to": str(directory)}, f"wrote {count} files to {directory}", json=json)


def wipe(
    *,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
    state_dir: StateDirOption = None,
    json: JsonOption = False,
) -> None:
    """Overwrite and remove keys, tokens, bundles and logs, at the end of a card's life.

    An SD card keeps old blocks where no program reaches them, and backups stay. Who must be sure
    destroys the card, or encrypts it before its first use.
    """
    from veilcam_server.system.backup import wipe_state  # noqa: PLC0415 - --help need not wait

    directory = state_dir or default_state_dir()
    enter_state(directory)
    if not yes and not typer.confirm(f"Overwrite and remove the state in {directory} for good?"):
        fail("nothing was changed")
    try:
        left = wipe_state(directory)
    except StartError as error:
        fail(str(error))
    words = f"wiped {directory}" + (f"; left: {', '.join(left)}" if left else "")
    _tell({"wiped": str(directory), "left": left}, words, json=json)


def _tell(found: Mapping[str, object], words: str, *, json: bool) -> None:
    typer.echo(encoder.dumps(found) if json else words)
