"""Command-line options that say how a real device is wired; each is a setting of ``Wiring``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

_WHERE = "Wiring"

PanelTab: TypeAlias = Annotated[
    str | None,
    typer.Option(help="Tab of the panel's film: red, black or green.", rich_help_panel=_WHERE),
]
Spi: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Bus of the panel. Default: /dev/spidev0.0.", rich_help_panel=_WHERE),
]
SpiClock: TypeAlias = Annotated[
    int | None,
    typer.Option(
        help="Clock of the bus in Hz. Default: 15000000; 15151515 is the panel's limit.",
        rich_help_panel=_WHERE,
    ),
]
FastSpi: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--allow-fast-spi",
        help="Allow a clock beyond that limit, with a warning.",
        rich_help_panel=_WHERE,
    ),
]
GpioChip: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Label of the GPIO chip. Default: that of a Raspberry Pi 5 or 4.",
        rich_help_panel=_WHERE,
    ),
]
DataLine: TypeAlias = Annotated[
    int | None, typer.Option(help="Line of A0 (D/C). Default: 25.", rich_help_panel=_WHERE)
]
ResetLine: TypeAlias = Annotated[
    int | None, typer.Option(help="Line of RESET. Default: 24.", rich_help_panel=_WHERE)
]
CameraNumber: TypeAlias = Annotated[
    int | None,
    typer.Option(help="Of those that are connected. Default: 0.", rich_help_panel=_WHERE),
]
ExposureFactor: TypeAlias = Annotated[
    float | None,
    typer.Option(
        help="The camera may expose so many times shorter or longer. Default: 1, fixed.",
        rich_help_panel=_WHERE,
    ),
]
