"""The wire contract of a simulated camera: what it looks at, and what is wrong with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from veilcam_client.errors import ArgumentError
from veilcam_client.wire.base import Answer, Question
from veilcam_client.wire.captures import NPY_MEDIA_TYPE

if TYPE_CHECKING:
    import numpy.typing as npt

_BEGINNINGS = {
    b"\x89PNG": "image/png",
    b"\xff\xd8\xff": "image/jpeg",
    b"RIFF": "image/webp",
    b"BM": "image/bmp",
    b"II": "image/tiff",
    b"MM": "image/tiff",
    b"GIF8": "image/gif",
    b"\x93NUMPY": NPY_MEDIA_TYPE,
}
PICTURE_MEDIA_TYPES = tuple(dict.fromkeys(_BEGINNINGS.values()))


class HeldScene(Answer):
    """Scene of a simulated camera from now on."""

    scene: int
    """Its number, as captures name it that see it."""
    warning: str | None = None
    """Warning that a picture uses less than an eighth of its range."""


class PanelFaults(Question):
    """Faults of a simulated panel."""

    dead: bool = False
    """No power: it ignores everything and is transparent all over the glass."""
    open_window: bool = False
    """Its window is transparent, whatever is written to it."""
    gone: bool = False
    """Unplugged: its bus fails, and nothing is in front of the sensor."""
    lost: int = Field(default=0, ge=0, le=1_000_000)
    """Every so many-th write to the bus is lost; 0 for none."""
    stuck: bool = False
    """It goes on showing what it shows."""
    inverted: bool = False
    """It shows light for dark."""
    asleep: bool = False
    """It fell asleep: transparent, until it is reset."""
    half: bool = False
    """Every write of pixels ends half-way."""
    shifted: bool = False
    """Every write of pixels lands one line too far."""


class SensorFaults(Question):
    """Faults of a simulated sensor."""

    gone: bool = False
    """Unplugged: it gives no frame, and cannot be opened again."""
    silent: bool = False
    """It gives no frame."""
    stuck: bool = False
    """It gives the same frame again and again."""


class LightFaults(Question):
    """Light of a simulated camera."""

    bypass: float = Field(default=0.0, ge=0, le=1)
    """Light that comes past the mask, as a share of the open window's, in [0, 1]."""
    lamp: float = Field(default=1.0, ge=0, le=1)
    """Brightness of the lamp from now on, in [0, 1]."""


class Faults(Question):
    """Faults of a simulated camera; none, unless they are given."""

    panel: PanelFaults = Field(default_factory=PanelFaults)
    """Faults of the panel."""
    sensor: SensorFaults = Field(default_factory=SensorFaults)
    """Faults of the sensor."""
    light: LightFaults = Field(default_factory=LightFaults)
    """Light on the sensor."""


def picture_bytes(picture: npt.ArrayLike | bytes) -> bytes:
    """Return a picture as it is sent: a file's content as it is, an array as ``.npy``.

    Raises:
        ArgumentError: neither bytes nor an array of numbers.
    """
    if isinstance(picture, bytes):
        return picture
    from veilcam_client.numbers import npy_bytes  # noqa: PLC0415 - loads NumPy

    try:
        return npy_bytes(picture)
    except (TypeError, ValueError):
        raise ArgumentError(
            f"picture cannot be a {type(picture).__name__}: use the content of a file, or an array "
            "of numbers, (rows, columns) or (rows, columns, 3)"
        ) from None


def picture_media_type(picture: bytes) -> str:
    """Return the media type of a picture's file, as its first bytes tell.

    Raises:
        ArgumentError: neither a PNG, JPEG, WebP, BMP, TIFF or GIF file, nor an ``.npy`` file.
    """
    for beginning, media_type in _BEGINNINGS.items():
        if picture.startswith(beginning):
            return media_type
    raise ArgumentError(
        "picture is none: give the content of a PNG, JPEG, WebP, BMP, TIFF, GIF or .npy file, or "
        "an array"
    )


def examples() -> tuple[Answer | Question, ...]:
    """Return examples for documents."""
    return (HeldScene(scene=1), Faults(panel=PanelFaults(dead=True)))
