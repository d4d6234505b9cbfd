"""How panel and camera are connected to a Raspberry Pi."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

GPIO_CHIPS = ("pinctrl-rp1", "pinctrl-bcm2711")
"""Labels of the chip with the header's lines: Raspberry Pi 5, and 4."""


class Wiring(BaseSettings):
    """What ``veilcamd`` can be told of a real device."""

    model_config = SettingsConfigDict(env_prefix="VEILCAM_", extra="forbid", frozen=True)

    panel_tab: Literal["red", "black", "green"] | None = None
    """Colour of the film's tab; a wrong one shifts or turns masks, so none is taken for granted."""
    spi: Path = Path("/dev/spidev0.0")
    spi_hz: int = Field(default=15_000_000, ge=100_000, le=100_000_000)
    """Clock of the bus [Hz]; the data sheet of the panel allows 15,151,515."""
    allow_fast_spi: bool = False
    gpio_chip: str | None = Field(default=None, min_length=1, max_length=64)
    """Label of the chip with both lines; by default whichever of a Raspberry Pi's is there."""
    data_line: int = Field(default=25, ge=0, le=1023)
    reset_line: int = Field(default=24, ge=0, le=1023)
    camera_number: int = Field(default=0, ge=0, le=15)
    exposure_factor: float = Field(default=1.0, ge=1, le=1000, allow_inf_nan=False)
    """How many times shorter or longer the camera may make the exposure by itself."""
