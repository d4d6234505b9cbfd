"""Panels and sensors: drivers that keep to ``base.py``, and what stands in for the hardware.

The drivers are an ST7735R on spidev and gpiod (``Display``) and an IMX477 on picamera2
(``Sensor``). The simulated camera is the same drivers on an emulated panel and a fake picamera2.
A configuration that names a device which is not there is refused; nothing falls back to a simulated
one.
"""

from veilcam_server.devices.base import Device, Display, Exposure, Sensor, Shown
from veilcam_server.devices.errors import (
    DeviceError,
    DeviceMissingError,
    DisplayError,
    SensorError,
    SensorHungError,
)

__all__ = [
    "Device",
    "DeviceError",
    "DeviceMissingError",
    "Display",
    "DisplayError",
    "Exposure",
    "Sensor",
    "SensorError",
    "SensorHungError",
    "Shown",
]
