"""Panels and sensors. Simulated ones stand here today.

For a real Raspberry Pi this package will hold drivers that keep to ``protocols.py``: an ST7735R on
spidev and gpiod (``Display``) and an IMX477 on picamera2 (``Sensor``). A configuration that names a
device which is not there is refused; nothing falls back to a simulated one.
"""

from veilcam_server.devices.errors import (
    DeviceError,
    DeviceMissingError,
    DisplayError,
    SensorError,
    SensorLostError,
    SensorTimeoutError,
)
from veilcam_server.devices.protocols import Device, Display, Exposure, Sensor, Shown

__all__ = [
    "Device",
    "DeviceError",
    "DeviceMissingError",
    "Display",
    "DisplayError",
    "Exposure",
    "Sensor",
    "SensorError",
    "SensorLostError",
    "SensorTimeoutError",
    "Shown",
]
