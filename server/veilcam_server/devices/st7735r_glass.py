"""The glass of an ST7735R panel: its sub-pixels, and how makers join it to the controller.

Sitronix data sheet, V0.2. The driver and the emulated panel both go by it.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

PIXEL_COLUMNS, PIXEL_ROWS, COLOURS = 128, 160, 3


@dataclass(frozen=True, slots=True)
class Tab:
    """Join of glass and controller by a maker; the colour of the protective film's tab tells.

    Attributes:
        name: name of the tab.
        column: address of the first visible pixel column.
        row: address of the first visible pixel row.
        memory: columns and rows of the controller that its GM pins choose to use.
        filters: colours of the sub-pixels of one pixel, in the order of the source lines. A panel
            with the order BGR is mounted turned by 180 degrees, so that R, G and B follow each
            other down the mask on both.
    """

    name: str
    column: int
    row: int
    memory: tuple[int, int]
    filters: Literal["RGB", "BGR"]


TABS: Final = MappingProxyType(
    {
        tab.name: tab
        for tab in (
            Tab("red", 0, 0, (128, 160), "BGR"),
            Tab("black", 0, 0, (128, 160), "RGB"),
            Tab("green", 2, 1, (132, 162), "BGR"),
        )
    }
)
"""Tabs by name. A wrong one shifts or swaps the mask, which is then another key."""
