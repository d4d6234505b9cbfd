"""Geometry of a camera: panel, window, sensor, scene. Lengths in metres.

Axis order is (rows, columns) everywhere. Rows run along the panel's fine axis, which lies along
the sensor's short side. The origin of every plane is the optical axis.
"""

import math
import re
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Self

from veilcam_optics.errors import (
    invalid,
    require,
    require_count,
    require_memory,
    require_positive,
    require_within,
)

CHANNELS = ("R", "G", "B")

WAVELENGTHS = (1e-8, 1e-3)
"""What is called light, from extreme ultraviolet to far infrared (ISO 20473), in metres."""

LENGTHS = (1e-8, 0.1)
"""Sides of sub-pixels and pixels that can be made [m]."""


@dataclass(frozen=True, slots=True)
class Panel:
    """An LCD as a grid of equal rectangular sub-pixels. Default: ST7735R, 1.8 inch (data sheet).

    The active area is 28.03 x 35.04 mm over 384 x 160 sub-pixels; R, G and B filters alternate
    from row to row. ``levels`` is what COLMOD 06 (6-6-6) can show on one sub-pixel.
    """

    rows: int = 384
    columns: int = 160
    pitch_y: float = 28.03e-3 / 384
    pitch_x: float = 35.04e-3 / 160
    aperture_y: float = 0.06e-3
    aperture_x: float = 0.18e-3
    levels: int = 64
    filter_cycle: tuple[int, ...] = (0, 1, 2)
    """Channel index (0 R, 1 G, 2 B) of row 0, 1, 2, ...; ``()`` for a panel without filters."""
    filter_leakage: float = 0.0
    """Amplitude that a filter passes of the two colours that are not its own; 0 is ideal."""
    filter_amplitudes: tuple[tuple[float, float, float], ...] = ()
    """Measured amplitudes, ``[filter][channel]``; they take the place of ``filter_leakage``."""

    def __post_init__(self) -> None:
        require_count("panel.rows", self.rows)
        require_count("panel.columns", self.columns)
        require_count("panel.levels", self.levels, least=2)
        for name in ("pitch_y", "pitch_x", "aperture_y", "aperture_x"):
            require_within(f"panel.{name}", getattr(self, name), "m", *LENGTHS)
        for axis in ("y", "x"):
            aperture, pitch = getattr(self, f"aperture_{axis}"), getattr(self, f"pitch_{axis}")
            require(
                aperture <= pitch,
                f"panel.aperture_{axis}",
                aperture,
                "m",
                f"at most the pitch, {pitch:.3e} m",
            )
        require(
            all(channel in range(len(CHANNELS)) for channel in self.filter_cycle),
            "panel.filter_cycle",
            self.filter_cycle,
            "",
            "indices 0 (R), 1, 2 (B)",
        )
        require_within("panel.filter_leakage", self.filter_leakage, "", 0, 1)
        table = self.filter_amplitudes
        square = len(table) in {0, len(CHANNELS)} and all(
            len(row) == len(CHANNELS) for row in table
        )
        require(
            square and all(0 <= amplitude <= 1 for row in table for amplitude in row),
            "panel.filter_amplitudes",
            table,
            "",
            "3 x 3 amplitudes from 0 to 1",
        )

    @property
    def fill_factor(self) -> float:
        """Share of the panel's area that is open."""
        return self.aperture_y * self.aperture_x / (self.pitch_y * self.pitch_x)

    def with_fill_factor(self, share: float) -> Self:
        """Return the same panel with apertures as wide for their pitch along both axes.

        Args:
            share: share of the panel's area that is open, above 0 and at most 1.
        """
        require(0 < share <= 1, "panel.fill_factor", share, "", "a share above 0, at most 1")
        side = math.sqrt(share)
        return replace(self, aperture_y=side * self.pitch_y, aperture_x=side * self.pitch_x)


@dataclass(frozen=True, slots=True)
class Window:
    """The part of the panel that is used as the mask, centred on the optical axis."""

    rows: int = 51
    columns: int = 22
    first_row: int = 168
    """Panel row of the window's first row: it fixes which filter each row carries."""
    first_column: int = 69

    def __post_init__(self) -> None:
        require_count("window.rows", self.rows)
        require_count("window.columns", self.columns)
        require_count("window.first_row", self.first_row, least=0)
        require_count("window.first_column", self.first_column, least=0)
        _require_held("window", self.rows, self.columns)


@dataclass(frozen=True, slots=True)
class Sensor:
    """A pixel grid. Default: Sony IMX477, the Raspberry Pi HQ camera (data sheet)."""

    rows: int = 3040
    columns: int = 4056
    pixel: float = 1.55e-6
    bit_depth: int = 12
    channel_weights: tuple[float, float, float] = (0.25, 0.5, 0.25)
    """Share of R, G and B in a gray measurement: binning the raw Bayer plane counts green twice."""

    def __post_init__(self) -> None:
        require_count("sensor.rows", self.rows)
        require_count("sensor.columns", self.columns)
        require_count("sensor.bit_depth", self.bit_depth)
        require_within("sensor.pixel", self.pixel, "m", *LENGTHS)
        require(
            len(self.channel_weights) == len(CHANNELS)
            and min(self.channel_weights) >= 0
            and abs(sum(self.channel_weights) - 1) <= 1e-9,
            "sensor.channel_weights",
            self.channel_weights,
            "",
            "three shares that sum to 1",
        )

    @property
    def height(self) -> float:
        """Length of the short side [m]."""
        return self.rows * self.pixel

    @property
    def width(self) -> float:
        """Length of the long side [m]."""
        return self.columns * self.pixel


@dataclass(frozen=True, slots=True)
class Camera:
    """Panel in front of sensor. ``distance`` is mask to sensor [m], ``wavelengths`` R, G, B [m]."""

    panel: Panel = field(default_factory=Panel)
    window: Window = field(default_factory=Window)
    sensor: Sensor = field(default_factory=Sensor)
    distance: float = 4e-3
    wavelengths: tuple[float, float, float] = (640e-9, 550e-9, 460e-9)

    def __post_init__(self) -> None:
        require_positive("camera.distance", self.distance, "m")
        for name, wavelength in zip(CHANNELS, self.wavelengths, strict=True):
            require_within(f"camera.wavelengths[{name}]", wavelength, "m", *WAVELENGTHS)
        require(
            self.window.first_row + self.window.rows <= self.panel.rows,
            "window.rows",
            self.window.rows,
            "rows",
            f"what fits {self.panel.rows} panel rows",
        )
        require(
            self.window.first_column + self.window.columns <= self.panel.columns,
            "window.columns",
            self.window.columns,
            "columns",
            f"what fits {self.panel.columns} panel columns",
        )

    def monochrome(self, wavelength: float) -> Self:
        """Return the same camera under light of one ``wavelength`` [m], without colours anywhere.

        The panel has no filters, and a measurement is that of one channel: the others, of the same
        wavelength, count nothing and cost nothing.
        """
        return replace(
            self,
            panel=replace(self.panel, filter_cycle=(), filter_leakage=0.0, filter_amplitudes=()),
            sensor=replace(self.sensor, channel_weights=(0.0, 1.0, 0.0)),
            wavelengths=(wavelength, wavelength, wavelength),
        )

    @property
    def mask_shape(self) -> tuple[int, int]:
        """Shape (rows, columns) of a mask for this camera."""
        return self.window.rows, self.window.columns

    @property
    def row_centres(self) -> tuple[float, ...]:
        """Centre of every mask row on the y axis [m]."""
        middle = (self.window.rows - 1) / 2
        return tuple((row - middle) * self.panel.pitch_y for row in range(self.window.rows))

    @property
    def column_centres(self) -> tuple[float, ...]:
        """Centre of every mask column on the x axis [m]."""
        middle = (self.window.columns - 1) / 2
        return tuple(
            (column - middle) * self.panel.pitch_x for column in range(self.window.columns)
        )

    def lit_sides(self, scene: "Scene") -> tuple[float, float]:
        """Height and width of the sensor and the scene's geometric image around it [m]."""
        image = scene.pixel_at_sensor(self)
        return (
            self.sensor.height + scene.rows * image,
            self.sensor.width + scene.columns * image,
        )

    @lru_cache(maxsize=128)  # noqa: B019 - of a few cameras, which hold little
    def row_amplitudes(self, channel: int) -> tuple[float, ...]:
        """Amplitude, in [0, 1], that each mask row's filter passes of channel 0 R, 1 G or 2 B."""
        cycle, first = self.panel.filter_cycle, self.window.first_row
        if not cycle:
            return (1.0,) * self.window.rows
        if self.panel.filter_amplitudes:
            return tuple(
                self.panel.filter_amplitudes[cycle[(first + row) % len(cycle)]][channel]
                for row in range(self.window.rows)
            )
        return tuple(
            1.0 if cycle[(first + row) % len(cycle)] == channel else self.panel.filter_leakage
            for row in range(self.window.rows)
        )


@dataclass(frozen=True, slots=True)
class Scene:
    """A flat object: ``rows x columns`` square pixels, ``height`` [m] tall, ``distance`` [m] away.

    Default: an MNIST digit as the paper shows it (12 cm tall, 40 cm from the mask).
    """

    rows: int = 28
    columns: int = 28
    height: float = 0.12
    distance: float = 0.40

    def __post_init__(self) -> None:
        require_count("scene.rows", self.rows)
        require_count("scene.columns", self.columns)
        require_positive("scene.height", self.height, "m")
        require_positive("scene.distance", self.distance, "m")
        _require_held("scene", self.rows, self.columns)

    @property
    def pixel(self) -> float:
        """Side of one scene pixel, in the scene [m]."""
        return self.height / self.rows

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (rows, columns) of the scene."""
        return self.rows, self.columns

    def pixel_at_sensor(self, camera: Camera) -> float:
        """Side of one scene pixel's geometric image on the sensor [m]."""
        return self.pixel * camera.distance / self.distance


@dataclass(frozen=True, slots=True)
class Embedding:
    """The grid to which the whole sensor is binned: ``rows x columns`` area averages.

    The sensor is cut into equal embedding pixels. A value is the mean over a box in the middle of
    one; a small box keeps detail that a full one averages away.
    """

    rows: int = 24
    columns: int = 32
    fill: float = 1.0
    """Side of the box, as a share of the embedding pixel's, above 0 and at most 1."""

    def __post_init__(self) -> None:
        require_count("embedding.rows", self.rows)
        require_count("embedding.columns", self.columns)
        require(0 < self.fill <= 1, "embedding.fill", self.fill, "", "a share above 0, at most 1")
        _require_held("embedding", self.rows, self.columns)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (rows, columns) of the embedding."""
        return self.rows, self.columns

    @property
    def size(self) -> int:
        """Number of values of one embedding."""
        return self.rows * self.columns

    def box(self, sensor: Sensor) -> tuple[float, float]:
        """Return height and width of the averaged boxes on a sensor [m]."""
        return self.fill * sensor.height / self.rows, self.fill * sensor.width / self.columns

    def __str__(self) -> str:
        """Return the text form that :meth:`parse` reads, e.g. ``24x32`` or ``24x32@0.1``."""
        fill = "" if self.fill == 1 else f"@{self.fill}"
        return f"{self.rows}x{self.columns}{fill}"

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the embedding of a text: rows, columns and, unless it is 1, the fill.

        Raises:
            OpticsError: a text of another form, or a number that is out of range.
        """
        number, share = "([1-9][0-9]{0,3})", r"([0-9]*\.?[0-9]+(?:e-[0-9]+)?)"
        match = re.fullmatch(f"{number}x{number}(?:@{share})?", text)
        if match is None:
            form = "ROWSxCOLUMNS or ROWSxCOLUMNS@FILL, e.g. 24x32 or 24x32@0.1"
            raise invalid("embedding", text, "", form)
        return cls(int(match[1]), int(match[2]), float(match[3] or 1))


def _require_held(argument: str, rows: int, columns: int) -> None:
    """Refuse a grid of which not even one copy could be held."""
    numbers = min(rows * columns, 10**30)  # what is larger may not be a float
    require_memory(argument, f"{rows} x {columns}", "numbers", numbers, "fewer rows or columns")
