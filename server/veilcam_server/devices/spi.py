"""Bus and lines of a panel; on Linux adapters to spidev and gpiod, which a device has."""

from __future__ import annotations

import ctypes
import fcntl
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol, Self

from veilcam_server.devices.errors import DeviceMissingError
from veilcam_server.devices.extras import import_extra
from veilcam_server.settings import Wiring

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
            OSError: they were not sent, or not all.
        """

    def read(self, command: int, count: int) -> bytes:
        """Send a byte, then receive ``count`` of them before CS rises.

        Raises:
            OSError: the bus failed. That nobody answers is no error.
        """

    def close(self) -> None:
        """Let go of the bus."""


class Lines(Protocol):
    """The two lines beside the bus. Both raise ``OSError`` when the line cannot be driven."""

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
            path: of the device node, e.g. ``/dev/spidev0.0``.
            speed: clock of the bus [Hz]; the kernel rounds it down to what the chip can do.
            one_wire: whether answers come on the wire that was written to, and not on MISO.

        Raises:
            DeviceMissingError: no such node, another kind of name, no right to open it, no spidev
                to import, or the bus cannot turn its wire around.
        """
        node = re.fullmatch(r"/dev/spidev([0-9]+)\.([0-9]+)", path)
        if node is None:
            raise DeviceMissingError(f"{path} is no bus of spidev's: give --spi /dev/spidev0.0")
        device = import_extra("spidev").SpiDev()
        try:
            # Not open_path: the spidev of Debian 12 and 13, which is 3.6, does not have it.
            device.open(*map(int, node.groups()))
            device.mode = 0
            device.max_speed_hz = speed
        except OSError as error:
            device.close()
            raise DeviceMissingError(
                f"{path} cannot be opened ({error.strerror}): switch SPI on with raspi-config, "
                "and be in the group spi"
            ) from None
        if one_wire:
            try:
                device.threewire = True
            except OSError as error:
                device.close()
                raise DeviceMissingError(
                    f"{path} cannot turn its wire around ({error}): wire the panel's SDA to MISO "
                    "too, and give --panel-read-back miso"
                ) from None
        return cls(device)

    def write(self, buffer: memoryview | bytes) -> None:
        """Send all bytes; spidev splits them at its buffer's size."""
        self._device.writebytes2(buffer)

    def read(self, command: int, count: int) -> bytes:
        """Send a byte and receive others, one after the other and under one CS.

        No call of spidev's does that: its ``xfer2`` sends while it receives, and CS rises between
        ``writebytes`` and ``readbytes``.
        """
        sent, answer = ctypes.c_uint8(command), (ctypes.c_uint8 * count)()
        speed = min(self._device.max_speed_hz, FASTEST_READ)
        message = (_Transfer * 2)(
            _Transfer(tx_buf=ctypes.addressof(sent), len=1, speed_hz=speed),
            _Transfer(rx_buf=ctypes.addressof(answer), len=count, speed_hz=speed),
        )
        fcntl.ioctl(self._device.fileno(), _MESSAGE_OF_TWO, message)
        return bytes(answer)

    def close(self) -> None:
        """Let go of the bus."""
        self._device.close()


class LinuxLines:
    """``Lines`` on libgpiod 2: one request for both."""

    def __init__(self, request: Any, *, data: int, reset: int) -> None:
        self._request, self._data, self._reset = request, data, reset
        value = import_extra("gpiod").line.Value
        self._low, self._high = value.INACTIVE, value.ACTIVE

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
        output = gpiod.LineSettings(
            direction=gpiod.line.Direction.OUTPUT, output_value=gpiod.line.Value.ACTIVE
        )
        try:
            request = gpiod.request_lines(path, consumer="veilcamd", config={(data, reset): output})
        except (OSError, ValueError) as error:
            raise DeviceMissingError(
                f"lines {data} and {reset} of {path} cannot be used ({error}): see with gpioinfo "
                "who has them, and be in the group gpio"
            ) from None
        return cls(request, data=data, reset=reset)

    def data(self, value: bool, /) -> None:
        """Drive D/C."""
        self._request.set_value(self._data, self._high if value else self._low)

    def reset(self, value: bool, /) -> None:
        """Drive RST, which resets when low."""
        self._request.set_value(self._reset, self._low if value else self._high)

    def close(self) -> None:
        """Let go of the lines."""
        self._request.release()


@contextmanager
def open_bus(wiring: Wiring) -> Iterator[tuple[LinuxSpi, LinuxLines]]:
    """Open the bus and the lines of a panel as they are wired; closed again if the block raises.

    Args:
        wiring: which ones, and how fast.

    Raises:
        DeviceMissingError: the bus or a line is not there.
    """
    with ExitStack() as undo:
        spi = LinuxSpi.open(
            str(wiring.spi), wiring.spi_hz, one_wire=wiring.panel_read_back == "sda"
        )
        undo.callback(spi.close)
        lines = LinuxLines.open(wiring.gpio_chip, data=wiring.data_line, reset=wiring.reset_line)
        undo.callback(lines.close)
        yield spi, lines
        undo.pop_all()


def gpio_chips() -> dict[str, Path]:
    """Return the chips that may be opened, by label.

    Raises:
        DeviceMissingError: there is no gpiod to import.
    """
    gpiod = import_extra("gpiod")
    chips: dict[str, Path] = {}
    for path in sorted(Path("/dev").glob("gpiochip*")):
        try:
            with gpiod.Chip(str(path)) as chip:
                # Of two with one label the first is the one with the header's lines.
                chips.setdefault(str(chip.get_info().label), path)
        except OSError:
            continue
    return chips


def line_user(chip: Path, line: int) -> str | None:
    """Return who has a line of a chip, None if it is free.

    Raises:
        OSError, ValueError: the chip cannot be opened, or has no such line.
    """
    with import_extra("gpiod").Chip(str(chip)) as opened:
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
