"""The wire contract of a simulated camera: what it looks at, and what is wrong with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from veilcam_client.wire.base import Answer, Examples, Question
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
    """What a simulated camera looks at from now on."""

    scene: int
    """Its number, as captures name it that see it."""
    warning: str | None = None
    """What makes a picture show less than it could: it uses under an eighth of its range."""


class PanelFaults(Question):
    """What is wrong with a simulated panel."""

    dead: bool = False
    """No power: it ignores everything and is transparent."""
    gone: bool = False
    """Unplugged: its bus fails, and nothing is in front of the sensor."""
    lost: int = Field(default=0, ge=0, le=1_000_000)
    """Every so many-th write to the bus is lost; 0 for none."""
    stuck: bool = False
    """It goes on showing what it shows."""
    inverted: bool = False
    """It shows light for dark."""


class SensorFaults(Question):
    """What is wrong with a simulated sensor."""

    gone: bool = False
    """Unplugged: it gives no frame, and cannot be opened again."""
    silent: bool = False
    """It gives no frame."""
    stuck: bool = False
    """It gives the same frame again and again."""


class Faults(Question):
    """What is wrong with a simulated camera; nothing, unless it is said."""

    panel: PanelFaults = Field(default_factory=PanelFaults)
    sensor: SensorFaults = Field(default_factory=SensorFaults)


def picture_bytes(picture: npt.ArrayLike | bytes) -> bytes:
    """Return a picture as it is sent: a file's content as it is, an array as ``.npy``."""
    if isinstance(picture, bytes):
        return picture
    from veilcam_client.numbers import npy_bytes  # noqa: PLC0415 - loads NumPy

    return npy_bytes(picture)


def picture_media_type(picture: bytes) -> str:
    """Return the media type of a picture's file, as its first bytes tell.

    Raises:
        ValueError: neither a PNG, JPEG, WebP, BMP, TIFF or GIF file, nor an ``.npy`` file.
    """
    for beginning, media_type in _BEGINNINGS.items():
        if picture.startswith(beginning):
            return media_type
    raise ValueError(
        "this is no picture: give the content of a PNG, JPEG, WebP, BMP, TIFF, GIF or .npy file"
    )


EXAMPLES = Examples(lambda: (HeldScene(scene=1), Faults(panel=PanelFaults(dead=True))))
