"""Bus and lines of a panel; on Linux adapters to spidev and gpiod, which a device has."""

from __future__ import annotations

import ctypes
import fcntl
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Protocol, Self

from veilcam_server.devices.errors import (
    DeviceMissingError,
    DisplayError,
    Refused,
    in_one_line,
    without_text,
)
from veilcam_server.devices.extras import import_extra, reinstall
from veilcam_server.wiring import Wiring

GPIO_CHIPS = ("pinctrl-rp1", "pinctrl-bcm2711")
"""Labels of the chip with the header's lines: Raspberry Pi 5, and 4."""
FASTEST_READ = 2_000_000
"""Clock at which a panel is read [Hz]: that of Linux's own drivers (drm_mipi_dbi.c)."""
_MESSAGE_OF_TWO = 0x4040_6B00
"""SPI_IOC_MESSAGE(2) of linux/spi/spidev.h."""


class _Transfer(ctypes.Structure):
    """struct spi_ioc_transfer of linux/spi/spidev.h."""

    _fields_ = (
        ("tx_buf", ctypes.c_uint64),
        ("rx_buf", ctypes.c_uint64),
        ("len", ctypes.c_uint32),
        ("speed_hz", ctypes.c_uint32),
        ("delay_usecs", ctypes.c_uint16),
        ("bits_per_word", ctypes.c_uint8),
        ("cs_change", ctypes.c_uint8),
        ("tx_nbits", ctypes.c_uint8),
        ("rx_nbits", ctypes.c_uint8),
        ("word_delay_usecs", ctypes.c_uint8),
        ("pad", ctypes.c_uint8),
    )


class Spi(Protocol):
    """The bus to the panel, mode 0, most significant bit first."""

    def write(self, buffer: memoryview | bytes) -> None:
        """Send all bytes and return once the last is out.

        Raises:
            DisplayError, OSError: they were not sent, or not all.
        """

    def read(self, command: int, count: int) -> bytes:
        """Send a byte, then receive ``count`` of them before CS rises.

        Raises:
            DisplayError, OSError: the bus failed. That nobody answers is no error.
        """

    def close(self) -> None:
        """Let go of the bus."""


class Lines(Protocol):
    """The two lines beside the bus; ``DisplayError`` or ``OSError`` if one cannot be driven."""

    def data(self, value: bool, /) -> None:
        """Drive D/C: true for parameters and pixels, false for a command."""

    def reset(self, value: bool, /) -> None:
        """Drive RST: true holds the panel in reset (the line is low)."""

    def close(self) -> None:
        """Let go of the lines."""


class LinuxSpi:
    """A ``Spi`` on spidev."""

    def __init__(self, device: Any) -> None:
        self._device = device

    @classmethod
    def open(cls, path: str, speed: int, *, one_wire: bool = False) -> Self:
        """Open a bus.

        Args:
            path: path of the device node, e.g. ``/dev/spidev0.0``.
            speed: clock of the bus [Hz]; the kernel rounds it down to what the chip can do.
            one_wire: True: answers come on the wire that was written to, and not on MISO.

        Raises:
            DeviceMissingError: no such node, another kind of name, no right to open it, no spidev
                to import, or the bus cannot turn its wire around.
        """
        node = re.fullmatch(r"/dev/spidev([0-9]+)\.([0-9]+)", path)
        if node is None:
            raise DeviceMissingError(f"{path} is no bus of spidev's: give --spi /dev/spidev0.0")
        with ExitStack() as undo:
            with Refused(partial(_bus_missing, path)):
                device = import_extra("spidev").SpiDev()
                undo.callback(_quietly, device.close)
                # Not open_path: the spidev of Debian 12 and 13, which is 3.6, does not have it.
                device.open(*map(int, node.groups()))
                device.mode = 0
                device.max_speed_hz = speed
            if one_wire:
                with Refused(partial(_not_turned, path)):
                    device.threewire = True
            undo.pop_all()
        return cls(device)

    def write(self, buffer: memoryview | bytes) -> None:
        """Send all bytes; spidev splits them at its buffer's size."""
        with Refused(bus_failed):
            taken = self._device.writebytes2(buffer)
            if taken is not None and taken != len(buffer):
                raise SystemError

    def read(self, command: int, count: int) -> bytes:
        """Send a byte and receive others, one after the other and under one CS.

        No call of spidev's does that: its ``xfer2`` sends while it receives, and CS rises between
        ``writebytes`` and ``readbytes``.
        """
        sent, answer = ctypes.c_uint8(command), (ctypes.c_uint8 * count)()
        with Refused(bus_failed):
            speed = min(self._device.max_speed_hz, FASTEST_READ)
            message = (_Transfer * 2)(
                _Transfer(tx_buf=ctypes.addressof(sent), len=1, speed_hz=speed),
                _Transfer(rx_buf=ctypes.addressof(answer), len=count, speed_hz=speed),
            )
            fcntl.ioctl(self._device.fileno(), _MESSAGE_OF_TWO, message)
        return bytes(answer)

    def close(self) -> None:
        """Let go of the bus."""
        with Refused(bus_failed):
            self._device.close()


class LinuxLines:
    """``Lines`` on libgpiod 2: one request for both, and the values of low and high."""

    def __init__(self, request: Any, values: tuple[Any, Any], *, data: int, reset: int) -> None:
        self._request, self._data, self._reset = request, data, reset
        self._low, self._high = values

    @classmethod
    def open(cls, chip: str | None, *, data: int, reset: int) -> Self:
        """Ask for both lines as outputs: commands, and not in reset.

        Args:
            chip: label, ``pinctrl-rp1`` on a Raspberry Pi 5 and ``pinctrl-bcm2711`` on a 4; None
                for whichever of these is there. Its number changes from kernel to kernel.
            data: line of D/C.
            reset: line of RST.

        Raises:
            DeviceMissingError: no such chip, no right to use it, a line is taken, or no gpiod to
                import.
        """
        gpiod = import_extra("gpiod")
        path = _chip_path(chip)
        with Refused(partial(_lines_missing, f"lines {data} and {reset} of {path}")):
            values = gpiod.line.Value.INACTIVE, gpiod.line.Value.ACTIVE
            output = gpiod.LineSettings(
                direction=gpiod.line.Direction.OUTPUT, output_value=gpiod.line.Value.ACTIVE
            )
            request = gpiod.request_lines(path, consumer="veilcamd", config={(data, reset): output})
        return cls(request, values, data=data, reset=reset)

    def data(self, value: bool, /) -> None:
        """Drive D/C."""
        with Refused(_lines_failed):
            self._request.set_value(self._data, self._high if value else self._low)

    def reset(self, value: bool, /) -> None:
        """Drive RST, which resets when low."""
        with Refused(_lines_failed):
            self._request.set_value(self._reset, self._low if value else self._high)

    def close(self) -> None:
        """Let go of the lines."""
        with Refused(_lines_failed):
            self._request.release()


@contextmanager
def open_bus(wiring: Wiring) -> Iterator[tuple[LinuxSpi, LinuxLines]]:
    """Open the bus and the lines of a panel as they are wired; closed again if the block raises.

    Args:
        wiring: lines of the wiring, and their speed.

    Raises:
        DeviceMissingError: the bus or a line is not there.
    """
    with ExitStack() as undo:
        spi = LinuxSpi.open(
            str(wiring.spi), wiring.spi_hz, one_wire=wiring.panel_read_back == "sda"
        )
        undo.callback(_quietly, spi.close)
        lines = LinuxLines.open(wiring.gpio_chip, data=wiring.data_line, reset=wiring.reset_line)
        undo.callback(_quietly, lines.close)
        yield spi, lines
        undo.pop_all()


def gpio_chips() -> dict[str, Path]:
    """Return the chips that may be opened, by label.

    Raises:
        DeviceMissingError: there is no gpiod to import, or it fails.
    """
    gpiod = import_extra("gpiod")
    chips: dict[str, Path] = {}
    for path in sorted(Path("/dev").glob("gpiochip*")):
        # One that may not be opened is none; whatever else fails is gpiod's fault.
        with (
            Refused(partial(_lines_missing, f"lines of {path}")),
            suppress(OSError),
            gpiod.Chip(str(path)) as chip,
        ):
            # Of two with one label the first is the one with the header's lines.
            chips.setdefault(str(chip.get_info().label), path)
    return chips


def line_user(chip: Path, line: int) -> str | None:
    """Return who has a line of a chip, None if it is free.

    Raises:
        DeviceMissingError: the chip cannot be opened, or has no such line, or gpiod fails.
    """
    gpiod = import_extra("gpiod")
    with Refused(partial(_lines_missing, f"line {line} of {chip}")):
        with gpiod.Chip(str(chip)) as opened:
            info = opened.get_line_info(line)
        return str(info.consumer or "the kernel") if info.used else None


def _chip_path(label: str | None) -> str:
    """Path of the chip with that label; None for that of a Raspberry Pi."""
    wanted = GPIO_CHIPS if label is None else (label,)
    chips = gpio_chips()
    for wish in wanted:
        if wish in chips:
            return str(chips[wish])
    raise DeviceMissingError(
        f"there is no GPIO chip {' or '.join(wanted)}: give --gpio-chip one of "
        f"{', '.join(chips) or 'those of gpiodetect'}, and be in the group gpio"
    )


def _quietly(close: Callable[[], object]) -> None:
    """Close what is given up; the reason for that is the error to be told."""
    with suppress(Exception):
        close()


def _bus_missing(path: str, error: Exception) -> DeviceMissingError:
    remedy = "switch SPI on with raspi-config, and be in the group spi"
    if not isinstance(error, OSError):
        remedy = reinstall("spidev")
    return DeviceMissingError(f"{path} cannot be opened ({in_one_line(error)}): {remedy}")


def _not_turned(path: str, error: Exception) -> DeviceMissingError:
    return DeviceMissingError(
        f"{path} cannot turn its wire around ({in_one_line(error)}): wire the panel's SDA to MISO "
        "too, and give --panel-read-back miso"
    )


def bus_failed(error: Exception) -> DisplayError:
    """Blame the bus; a text may tell of the mask that was on its way."""
    reason = without_text(error)
    if isinstance(error, SystemError):
        # That is how py-spidev tells of one: its C code returns an error without naming any.
        reason = "short write, it took a part of the bytes"
    return DisplayError(f"the panel's bus failed ({reason}): check its wiring and power")


def _lines_missing(lines: str, error: Exception) -> DeviceMissingError:
    remedy = "see with gpioinfo who has them, and be in the group gpio"
    if not isinstance(error, (OSError, ValueError)):
        remedy = reinstall("gpiod")
    return DeviceMissingError(f"{lines} cannot be used ({in_one_line(error)}): {remedy}")


def _lines_failed(error: Exception) -> DisplayError:
    return DisplayError(
        f"the panel's GPIO lines failed ({in_one_line(error)}): see with gpioinfo who has them"
    )
