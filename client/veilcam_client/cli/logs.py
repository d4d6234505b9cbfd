"""``veilcam log`` and ``veilcam verify``: print or fetch a log, and check it without the camera."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ConfigDict, TypeAdapter, ValidationError

from veilcam_client.cli.terminal import FORGED, Ask, DeviceOption, JsonOption, asking, errors, tell
from veilcam_client.errors import FileError
from veilcam_client.log_file import fetch_log
from veilcam_client.wire.captures import Capture, Classification
from veilcam_client.wire.log import RECORDS_AT_ONCE, LogRecord

_ANSWER: TypeAdapter[Capture | Classification] = TypeAdapter(
    Classification | Capture, config=ConfigDict(defer_build=True)
)
_FILE = typer.Argument(metavar="FILE", help="Of records, one a line.")


@asking()
def log(
    ask: Ask,
    file: Annotated[Path | None, _FILE] = None,
    *,
    last: Annotated[int, typer.Option(min=1, max=RECORDS_AT_ONCE, help="Records to print.")] = 100,
) -> None:
    """Print what left a camera and who changed it, or fetch the signed log into FILE.

    A FILE that is there is gone on with. A token needs read:log.
    """
    with ask.camera() as camera:
        if file is None:
            page = camera.log.list(limit=last, newest=True)
            ask.tell(page.model_dump(mode="json"), "\n".join(map(_in_words, page.records)))
        else:
            added = fetch_log(camera.log, file)
            ask.tell({"added": added, "file": str(file)}, f"{added} records more in {file}")


def verify(
    file: Annotated[Path, _FILE],
    *,
    device: DeviceOption = None,
    head: Annotated[
        Path | None, typer.Option(help="Earlier copy of the log, or its last line.")
    ] = None,
    answer: Annotated[
        Path | None, typer.Option(help="Answer that must be in it, as JSON and as it left.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Check a log, and exit with 7 if something does not hold. No camera is asked."""
    from veilcam_client.keys.log import verify_log  # noqa: PLC0415 - late: the cryptography

    with errors():
        content, before = _content(file), None if head is None else _content(head)
        try:
            given = None if answer is None else _ANSWER.validate_json(_content(answer))
            found = verify_log(content, device=device, head=before, answer=given)
        except ValidationError:
            raise FileError(f"{answer} holds something else: give the answer as JSON") from None
        except ValueError as error:
            raise FileError(f"{answer}: {error}") from None
    words = [f"the camera says: {said}" for said in found.said]
    words += [f"wrong: {finding}" for finding in found.findings]
    if found.answer is not None:
        words.append(f"the answer is that of record {found.answer}")
    if found.device is not None:
        words.append(f"device {found.device}")
    holds = f"{len(found.findings)} findings" if found.findings else "all of it holds"
    if device is None and not found.findings:
        holds += ", for whoever has that device's key: give --device to know that it is yours"
    words.append(f"{found.records} records, {found.captures} captures: {holds}")
    tell({"holds": not found.findings, **asdict(found)}, "\n".join(words), json=json)
    if found.findings:
        sys.exit(FORGED)


def _in_words(record: LogRecord) -> str:
    words = "  ".join(f"{name} {value}" for name, value in record.facts.items())
    # Paths and labels are whatever somebody sent: no control character reaches the terminal.
    words = "".join(each if each.isprintable() else ascii(each)[1:-1] for each in words)
    return f"{record.position:>6}  {record.at:%Y-%m-%d %H:%M:%S}  {record.kind:<8}  {words}"


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError(f"{path} cannot be read ({error.strerror}): check it") from None
