"""``veilcamd doctor``: what is missing on this machine, and how to get it."""

from __future__ import annotations

import dataclasses
import json as encoder

import typer

from veilcam_server.cli.options import options_of
from veilcam_server.cli.terminal import JsonOption, fail
from veilcam_server.errors import StartError
from veilcam_server.wiring import DoctorSettings

_SIGNS = {"ok": ("ok", "green"), "bad": ("FIX", "bold red"), "skipped": ("later", "yellow")}


@options_of(DoctorSettings)
def doctor(
    settings: DoctorSettings,
    *,
    json: JsonOption = False,
) -> None:
    """Say what this machine lacks to serve a real camera, and what to do about it.

    Ends with 0 if it lacks nothing. Run it as the user that the daemon will have, and stop the
    daemon first: it holds the camera and the panel's lines.
    """
    # Imported late: --help need not wait for them.
    from veilcam_server.devices.errors import DeviceError  # noqa: PLC0415
    from veilcam_server.doctor.checkup import examine  # noqa: PLC0415
    from veilcam_server.doctor.machine import Machine  # noqa: PLC0415
    from veilcam_server.system.state_folder import become_owner  # noqa: PLC0415

    try:
        # What root may do says nothing of the daemon's user.
        become_owner(settings.state_dir)
        findings = list(examine(Machine(), settings))
    except (DeviceError, StartError) as error:
        fail(str(error))
    if json:
        typer.echo(encoder.dumps([dataclasses.asdict(finding) for finding in findings], indent=2))
    else:
        from rich.console import Console  # noqa: PLC0415
        from rich.table import Table  # noqa: PLC0415
        from rich.text import Text  # noqa: PLC0415

        table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
        for finding in findings:
            sign, style = _SIGNS[finding.outcome]
            table.add_row(Text(sign, style), finding.name, Text(finding.found))
            if finding.remedy is not None:
                table.add_row("", "", Text(f"-> {finding.remedy}", "bold"))
        Console().print(table)
        wrong = sum(finding.outcome == "bad" for finding in findings)
        typer.echo(f"\n{wrong} to fix" if wrong else "\nall is well")
    raise SystemExit(any(finding.outcome != "ok" for finding in findings))
