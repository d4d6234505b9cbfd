"""``veilcam log`` and ``veilcam verify``: fetch a capture log, and check it without the camera."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from veilcam_client.cli.terminal import (
    FORGED,
    USAGE,
    Ask,
    DeviceOption,
    JsonOption,
    asking,
    errors,
    fail,
    tell,
)
from veilcam_client.log_file import fetch_log, verify_log

if TYPE_CHECKING:
    from veilcam_client.keys.log_check import Examination

LogFile = Annotated[Path, typer.Argument(metavar="FILE", help="Of records, one a line.")]


@asking()
def log(
    ask: Ask,
    file: LogFile,
    *,
    head: Annotated[
        Path | None, typer.Option(help="Write the signed head of the log to this file.")
    ] = None,
) -> None:
    """Fetch the signed log of what a camera answered, or go on where FILE ends.

    A token needs read:log.
    """
    with ask.camera() as camera:
        added, ends = fetch_log(camera.log, file)
    if head is not None:
        try:
            head.write_text(f"{ends.model_dump_json()}\n")
        except OSError as error:
            fail(f"cannot write {head}: {error.strerror}", USAGE)
    found = {"added": added, "file": str(file), "position": ends.position}
    words = f"{added} records more in {file}, up to record {ends.position}"
    ask.tell(found, words)


def verify(
    file: LogFile,
    *,
    device: DeviceOption = None,
    head: Annotated[
        Path | None, typer.Option(help="Signed head that the log must have had, as JSON.")
    ] = None,
    answer: Annotated[
        Path | None, typer.Option(help="Answer that must be in it, as JSON and as it left.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Check a log, and exit with 17 if something does not hold. No camera is asked."""
    with errors():
        found = verify_log(file, device=device, head=head, answer=answer)
    told = {
        "holds": not found.findings,
        "records": found.records,
        "captures": found.captures,
        "device": found.device,
        "answer": found.answer,
        "findings": [str(finding) for finding in found.findings],
        "said": [str(said) for said in found.said],
    }
    tell(told, "\n".join(_in_words(found, whose=device)), json=json)
    if found.findings:
        sys.exit(FORGED)


def _in_words(found: Examination, *, whose: str | None) -> Iterator[str]:
    """Return the findings, a line each."""
    for said in found.said:
        yield f"the camera says: {said}"
    for finding in found.findings:
        yield f"wrong: {finding}"
    if found.answer is not None:
        yield f"the answer is that of record {found.answer}"
    if found.device is not None:
        yield f"device {found.device}"
    holds = f"{len(found.findings)} findings" if found.findings else "all of it holds"
    if whose is None and not found.findings:
        holds += ", for whoever has that device's key: give --device to know that it is yours"
    yield f"{found.records} records, {found.captures} captures: {holds}"
