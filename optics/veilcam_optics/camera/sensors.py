"""Sensors by name: the Raspberry Pi cameras, and one to measure.

Figures: Raspberry Pi camera documentation, "Hardware specification", and Sony's product briefs;
black levels: libcamera's tuning files, scaled to the bit depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from veilcam_optics.camera.geometry import Sensor
from veilcam_optics.errors import invalid


@dataclass(frozen=True, slots=True)
class SensorModel:
    """A sensor that one can buy.

    Attributes:
        name: What it is called here.
        chip: The manufacturer's type number.
        sensor: Its pixel grid.
        black_level: What the converter gives without light [digital numbers].
        colour: Whether a Bayer filter (RGGB) covers it.
    """

    name: str
    chip: str
    sensor: Sensor
    black_level: int
    colour: bool = True


_MODELS = (
    SensorModel("HQ", "IMX477", Sensor(3040, 4056, 1.55e-6, 12), black_level=256),
    SensorModel("GS", "IMX296", Sensor(1088, 1456, 3.45e-6, 10), black_level=60),
    SensorModel("V2", "IMX219", Sensor(2464, 3280, 1.12e-6, 10), black_level=64),
    SensorModel("V3", "IMX708", Sensor(2592, 4608, 1.40e-6, 10), black_level=64),
)

SENSORS = MappingProxyType({model.name: model for model in _MODELS})
"""The catalogue, by name."""


def sensor_model(name: str) -> SensorModel:
    """Return the sensor called ``name``: HQ, GS (global shutter), V2 or V3.

    Raises:
        OpticsError: If there is none of that name.
    """
    if name not in SENSORS:
        raise invalid("name", repr(name), "", "one of " + ", ".join(SENSORS))
    return SENSORS[name]


def generic_sensor(
    rows: int, columns: int, pixel: float, bit_depth: int = 12, *, black_level: int = 0
) -> SensorModel:
    """Return a gray sensor of any size, ``pixel`` in metres.

    Raises:
        OpticsError: If a number has no physical meaning.
    """
    sensor = Sensor(rows, columns, pixel, bit_depth, (1 / 3, 1 / 3, 1 / 3))
    if not 0 <= black_level < 2**bit_depth:
        raise invalid("black_level", black_level, "", f"0 to {2**bit_depth - 1}")
    return SensorModel("generic", "", sensor, black_level, colour=False)
