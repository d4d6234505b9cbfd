"""Bytes on the panel's bus for one mask change, counted by the emulator below it.

    python -m benchmarks.daemon.spi --figures benchmarks/results/daemon.json

Every mask is compared with what the emulated panel then shows.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import typer
from benchmarks.figures import FiguresOption, record

from veilcam_optics.camera.geometry import Camera
from veilcam_server.devices.simulated.panel import PanelEmulator
from veilcam_server.devices.st7735r import FULL_FRAME, ST7735R
from veilcam_server.devices.st7735r_glass import TABS


def most_bytes(tab: str, masks: int) -> int:
    """Largest number of bytes of a mask change, over random masks for the default camera.

    Raises:
        RuntimeError: the panel does not show what was asked.
    """
    camera = Camera()
    window, random = camera.window, np.random.default_rng(0)
    emulator = PanelEmulator(TABS[tab], reset_time=0.0)
    panel = ST7735R(emulator, emulator, camera=camera, tab=TABS[tab], sleep=lambda _: None)
    most = 0
    for _ in range(masks):
        levels = random.integers(0, camera.panel.levels, camera.mask_shape, np.uint8)
        before = emulator.bytes_received
        panel.show(levels)
        most = max(most, emulator.bytes_received - before)
        expected = np.zeros((camera.panel.rows, camera.panel.columns), np.uint8)
        expected[
            window.first_row : window.first_row + window.rows,
            window.first_column : window.first_column + window.columns,
        ] = levels
        if not np.array_equal(emulator.framebuffer(), expected):
            raise RuntimeError(f"the panel with the {tab} tab does not show the mask")
    return most


def main(
    *,
    masks: Annotated[int, typer.Option(min=1, help="Random masks for each tab.")] = 1000,
    figures: FiguresOption = None,
) -> None:
    """Count what a mask change costs on the bus."""
    counts = {tab: most_bytes(tab, masks) for tab in TABS}
    for tab, count in counts.items():
        print(f"{tab} tab: {count} bytes a mask, of {FULL_FRAME} for the whole frame")
    record(figures, {"spi_bytes_mask_change": max(counts.values())})


if __name__ == "__main__":
    typer.run(main)
