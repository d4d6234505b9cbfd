"""Status of an ST7735R, where its data line can be read (Sitronix data sheet, V0.2).

The line goes both ways: after the last bit of a command the panel drives it, until CS rises
(9.4.2). Who it is and how it is set can be read so, not which picture is in its memory: the serial
interface gives back parameters of 8, 24 and 32 bits (9.4).
"""

from __future__ import annotations

from typing import Final

from veilcam_server.devices.errors import DisplayError
from veilcam_server.devices.spi import Lines, Spi

_RDDID: Final = (0x04, 24)
"""Code and bits of what identifies the maker's panel (10.1.3)."""
_RDDST: Final = (0x09, 32)
"""Of the status (10.1.4)."""
_RDDPM: Final = (0x0A, 8)
"""Of the power mode, which is part of the status (10.1.5)."""

_SOUND = 0x8063_0400
"""Status of a panel that shows 6-6-6 in normal mode, but for the order of its memory."""
_ORDER = 0xFC
"""Bits of MADCTL that the status repeats, 23 bits higher: MY, MX, MV, ML, RGB and MH."""
_SAYS = (
    (0x8000_0000, "its voltages are off"),  # BSTON
    (_ORDER << 23, "its memory is turned"),
    (0x0070_0000, "it takes another pixel format"),  # IFPF
    (0x0008_0000, "it shows eight colours"),  # IDMON
    (0x0005_0000, "it shows a part of its lines"),  # PTLON, NORON
    (0x0002_0000, "it sleeps"),  # SLPOUT
    (0x0000_2000, "it shows light for dark"),  # INVON
    (0x0000_0400, "its display is off"),  # DISON
)
"""What a bit means that is not as it was set; others are for gamma, the tearing line, or free."""
_TIMES: Final = 3
"""Questions before an answer is believed."""


def is_read(spi: Spi, lines: Lines, madctl: int) -> bool:
    """Return whether the panel, which was just set up, gives the status of a sound one each time.

    Where the board is wired otherwise than it was told, the line gives something else.

    Args:
        spi: bus of the panel.
        lines: D/C of it.
        madctl: order of its memory, as it was told.

    Raises:
        OSError: the bus failed.
    """
    return all(not _wrong(_ask(spi, lines, *_RDDST), madctl) for _ in range(_TIMES))


def require_sound(spi: Spi, lines: Lines, madctl: int) -> None:
    """Raise if the panel says each time that it does not show what is in its memory.

    A line that nobody drives, or an answer that changes, says nothing: that is for light to tell.

    Args:
        spi: bus of the panel.
        lines: D/C of it.
        madctl: order of its memory, as it was told.

    Raises:
        OSError: the bus failed.
        DisplayError: what is wrong.
    """
    found: set[int] = set()
    for _ in range(_TIMES):
        status = _ask(spi, lines, *_RDDST)
        found.add(status)
        if len(found) > 1 or _is_silent(status, *_RDDST) or not _wrong(status, madctl):
            return
    wrong = _wrong(found.pop(), madctl)
    told = [meaning for bits, meaning in _SAYS if wrong & bits]
    raise DisplayError(f"the panel answers that {', '.join(told)}: check its power and wiring")


def identify(spi: Spi, lines: Lines) -> str:
    """Return what the panel says of itself, in hexadecimal; nothing is changed.

    Args:
        spi: bus of the panel.
        lines: D/C of it.

    Raises:
        OSError: the bus failed.
        DisplayError: it does not answer, or contradicts itself.
    """
    identity, status, power = (_ask(spi, lines, *asked) for asked in (_RDDID, _RDDST, _RDDPM))
    _require_answer(identity, *_RDDID)
    # BSTON; IDMON, PTLON, SLPOUT and NORON; DISON.
    repeated = (status >> 24 & 0x80) | (status >> 13 & 0x78) | (status >> 8 & 0x04)
    if repeated != power:
        raise DisplayError(
            f"the panel's answers do not fit together, status {status:08x} and power mode "
            f"{power:02x}: check the wire of its SDA"
        )
    return f"identity {identity:06x}, status {status:08x}"


def _ask(spi: Spi, lines: Lines, code: int, bits: int) -> int:
    """Answers of 24 and 32 bits come one clock late, those of 8 bits at once (9.4.3)."""
    late = bits > 8
    lines.data(False)
    answer = int.from_bytes(spi.read(code, bits // 8 + late), "big")
    return answer >> 7 & ((1 << bits) - 1) if late else answer


def _wrong(status: int, madctl: int) -> int:
    """Bits that are not as they were set."""
    wrong = status ^ (_SOUND | (madctl & _ORDER) << 23)
    return sum(wrong & bits for bits, _ in _SAYS)


def _is_silent(answer: int, _: int, bits: int) -> bool:
    """Return whether nobody drives the line: it reads as all zeros, or all ones."""
    return answer in (0, (1 << bits) - 1)


def _require_answer(answer: int, code: int, bits: int) -> None:
    if _is_silent(answer, code, bits):
        raise DisplayError(
            f"the panel does not answer command {code:02X}h: check its power and the wire of its "
            "SDA, or leave out --panel-read-back"
        )
