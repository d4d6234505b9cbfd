"""Settings of the device: how panel and sensor are connected."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from veilcam_server.environment import PREFIX, default_state_dir, option_of

_BUS_WIRES = {"0": (9, 10, 11, 8, 7), "1": (19, 20, 21, 18, 17, 16)}
"""GPIO lines of a Raspberry Pi's buses: MISO, MOSI, SCLK, and CE of each device."""


class Wiring(BaseSettings):
    """Settings of ``veilcamd`` for a real device."""

    # Of the docstrings below 'veilcamd --help' is made, one command-line option of each.
    model_config = SettingsConfigDict(
        env_prefix=PREFIX,
        extra="forbid",
        frozen=True,
        use_attribute_docstrings=True,
        # What checks them takes a tenth of a second to build, and --help checks none.
        defer_build=True,
    )

    panel: str = "ST7735R"
    """Kind of panel."""
    sensor: str = "IMX477"
    """Kind of sensor."""
    # A wrong tab shifts or turns masks, so none is taken for granted.
    panel_tab: Literal["red", "black", "green"] | None = None
    """Tab of an ST7735R's film: red, black or green."""
    spi: Path = Path("/dev/spidev0.0")
    """Bus of the panel."""
    spi_hz: int = Field(default=15_000_000, ge=100_000, le=100_000_000)
    """Clock of the bus in Hz; 15151515 is an ST7735R's limit, and more is warned of."""
    gpio_chip: str | None = Field(default=None, min_length=1, max_length=64)
    """Label of the GPIO chip with both lines. Default: that of a Raspberry Pi 5 or 4."""
    data_line: int = Field(default=25, ge=0, le=1023)
    """Line of A0 (D/C)."""
    reset_line: int = Field(default=24, ge=0, le=1023)
    """Line of RESET."""
    panel_read_back: Literal["miso", "sda"] | None = None
    """Ask the panel after each mask whether it shows it: miso where its SDA is wired to MISO too,
    sda where the bus can turn its wire around (not on a Raspberry Pi 5). Default: it is not
    asked."""
    camera_number: int = Field(default=0, ge=0, le=15)
    """Of the cameras that are connected."""
    trust_clock: bool = False
    """Let quiet hours go by this machine's clock although the kernel does not call it synchronised:
    it has a battery, or the daemon is in a container."""


class DoctorSettings(Wiring):
    """Settings of ``veilcamd doctor``, about the daemon to come."""

    bundle: Path | None = None
    """That of 'veilcamd serve'."""
    owner_keys: Path | None = None
    """That of 'veilcamd serve'."""
    state_dir: Path = Field(default_factory=default_state_dir)
    """That of 'veilcamd serve'."""


def require_wires_apart(wiring: Wiring) -> None:
    """Raise ValueError where a line of the panel is another one, or a wire of its bus."""
    if wiring.data_line == wiring.reset_line:
        raise ValueError("--data-line and --reset-line are two lines: give two numbers")
    bus = re.fullmatch(r"/dev/spidev([01])\.([0-2])", str(wiring.spi))
    if bus is None or wiring.gpio_chip is not None:
        return
    wires, device = _BUS_WIRES[bus[1]], int(bus[2])
    taken = (*wires[:3], *wires[3 + device : 4 + device])
    for name in ("data_line", "reset_line"):
        line = getattr(wiring, name)
        if line in taken:
            raise ValueError(
                f"{option_of(name)} {line} is a wire of the bus --spi {wiring.spi}: give another"
            )
