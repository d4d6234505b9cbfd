"""``veilcamd doctor``: what is missing on this machine, and how to get it."""

from __future__ import annotations

import dataclasses
import json as encoder
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import ValidationError
from rich.console import Console
from rich.table import Table
from rich.text import Text

from veilcam_server.cli import options
from veilcam_server.cli.terminal import StateDirOption, fail, one_line
from veilcam_server.settings import Wiring, default_state_dir

_SIGNS = {"ok": ("ok", "green"), "bad": ("FIX", "bold red"), "skipped": ("later", "yellow")}


def doctor(
    *,
    bundle: Annotated[
        Path | None, typer.Option(envvar="VEILCAM_BUNDLE", help="That of 'veilcamd serve'.")
    ] = None,
    state_dir: StateDirOption = None,
    mask_secret: Annotated[
        Path | None, typer.Option(envvar="VEILCAM_MASK_SECRET", help="That of 'veilcamd serve'.")
    ] = None,
    panel_tab: options.PanelTab = None,
    spi: options.Spi = None,
    spi_hz: options.SpiClock = None,
    allow_fast_spi: options.FastSpi = False,
    gpio_chip: options.GpioChip = None,
    data_line: options.DataLine = None,
    reset_line: options.ResetLine = None,
    camera_number: options.CameraNumber = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Say what this machine lacks to serve a real camera, and what to do about it.

    Ends with 0 if it lacks nothing. Run it as the user that the daemon will have, and stop the
    daemon first: it holds the camera and the panel's lines.
    """
    # Imported late: --help need not wait for torch.
    from veilcam_server.doctor import Machine, Plan, examine  # noqa: PLC0415

    given: dict[str, Any] = {
        "panel_tab": panel_tab,
        "spi": spi,
        "spi_hz": spi_hz,
        "allow_fast_spi": allow_fast_spi or None,
        "gpio_chip": gpio_chip,
        "data_line": data_line,
        "reset_line": reset_line,
        "camera_number": camera_number,
    }
    try:
        wiring = Wiring(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        fail(one_line(error))
    plan = Plan(wiring, state_dir or default_state_dir(), bundle, mask_secret)
    findings = list(examine(Machine(), plan))
    if json:
        typer.echo(encoder.dumps([dataclasses.asdict(finding) for finding in findings], indent=2))
    else:
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
