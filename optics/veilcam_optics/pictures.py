"""Picture files: one reader decides formats, orientation, depth and damage."""

from __future__ import annotations

import io
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from veilcam_optics.errors import OpticsError

if TYPE_CHECKING:
    from PIL import Image
    from PIL.ImageFile import ImageFile

Values: TypeAlias = npt.NDArray[np.uint8 | np.uint16 | np.float32]
Order: TypeAlias = Literal["little", "big"]

FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "GIF")
"""Pillow's names of the formats; an MPO file is read as the JPEG that it begins with."""
KINDS = "PNG, JPEG, WebP, BMP, TIFF or GIF"
SUFFIXES = (".png", ".jpg", ".jpeg", ".mpo", ".webp", ".bmp", ".tif", ".tiff", ".gif")
MAX_BYTES = 2**30
MAX_PIXELS = 2**27
"""A small file can claim to have many more."""
LUMA = (0.299, 0.587, 0.114)
"""Shares of red, green and blue in gray (ITU-R BT.601)."""
LEAST_SHARE = 1 / 8
"""Of its range; a picture that uses less is dark or flat, or has 12 bits in a file of 16."""

_COLOURS = ("P", "PA", "RGB", "RGBA", "RGBa", "RGBX", "CMYK", "YCbCr")
_GRAYS = ("1", "L", "LA", "La")
_ORIENTATION, _XMP, _EXIF, _GPS = 0x0112, 0x02BC, 0x8769, 0x8825
_SIZES = {1: 1, 3: 2, 4: 4}
"""Bytes of a whole number, by its type in TIFF."""
_TURNS: Mapping[int, Callable[[Values], Values]] = {
    2: lambda values: values[:, ::-1],
    3: lambda values: values[::-1, ::-1],
    4: lambda values: values[::-1],
    5: lambda values: values.swapaxes(0, 1),
    6: lambda values: values.swapaxes(0, 1)[:, ::-1],
    7: lambda values: values[::-1, ::-1].swapaxes(0, 1),
    8: lambda values: values.swapaxes(0, 1)[::-1],
}
"""Stored picture to upright picture, by the orientation that EXIF tells."""


class PictureError(OpticsError):
    """Picture that cannot be used; the message goes on after its name."""


def read_picture(source: Path | bytes, *, most: int = MAX_PIXELS) -> Values:
    """Read a picture, turned upright as its orientation tag says; other metadata is not read.

    Args:
        source: file, or its content.
        most: largest number of pixels.

    Returns:
        (rows, columns) gray or (rows, columns, 3) in colour, black where it is transparent:
        uint8 or uint16, the largest number being white, or finite float32 of a float TIFF.
        An animation gives its first frame.

    Raises:
        PictureError: it cannot be opened, is damaged, too large or of another format, or would
            lose bits.
    """
    try:
        content = source if isinstance(source, bytes) else _content(source)
        bare, orientation = _without_metadata(content)
        values, exif = _decoded(bare, most)
    except PictureError:
        raise
    except Exception as error:  # Pillow raises whatever its decoders come across
        raise PictureError(f"is damaged ({_reason(error)}): get it again") from None
    if orientation == 1:
        orientation = _orientation(exif.removeprefix(b"Exif\0\0"))
    turn = _TURNS.get(orientation)
    return values if turn is None else np.ascontiguousarray(turn(values))


def white(values: npt.NDArray[Any]) -> float:
    """Return the number that stands for white: 1 of floats."""
    return 1.0 if values.dtype.kind == "f" else float(np.iinfo(values.dtype).max)


def check_reflectances(picture: npt.NDArray[Any]) -> None:
    """Raise :class:`PictureError` unless an array is a picture of reflectances.

    Args:
        picture: (rows, columns) or (rows, columns, 3), of uint8 or uint16, or floats in [0, 1].
    """
    if picture.ndim not in (2, 3) or picture.shape[2:] not in ((), (3,)) or picture.size == 0:
        raise PictureError(
            f"has the shape {picture.shape}: use (rows, columns), or (rows, columns, 3) for colour"
        )
    whole = picture.dtype.newbyteorder("=") in (np.uint8, np.uint16)
    if not whole and not (picture.dtype.kind == "f" and ((picture >= 0) & (picture <= 1)).all()):
        raise PictureError("holds no reflectances: use uint8, uint16, or floats in [0, 1]")


def as_scene(picture: npt.NDArray[Any], shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
    """Return a picture as a scene: cut about its centre to the scene's form, reduced by area.

    Args:
        picture: picture of :func:`check_reflectances`; the largest whole number is white.
        shape: (rows, columns) of the scene, whose pixels are square; (3, rows, columns) in colour.

    Returns:
        Reflectances in [0, 1], of ``shape``; gray is the Rec. 601 luma of colours.

    Raises:
        PictureError: it is no such picture.
    """
    from PIL import Image, ImageOps  # noqa: PLC0415 - only who reads pictures needs it

    check_reflectances(picture)
    rows, columns = shape[-2:]
    planes = [
        np.asarray(
            ImageOps.fit(
                Image.fromarray(np.asarray(plane, np.float32)),
                (columns, rows),
                Image.Resampling.BOX,
            )
        )
        for plane in np.moveaxis(np.atleast_3d(picture), 2, 0)
    ]
    scene = np.stack(planes) / np.float32(white(picture))
    if len(shape) == 2:
        scene = scene[0] if len(scene) == 1 else np.tensordot(LUMA, scene, 1)
    return np.array(np.broadcast_to(scene.clip(0, 1), shape), np.float32)


def used_range(values: npt.NDArray[Any]) -> str | None:
    """Return the part of its range that a picture uses, in words; None for an eighth or more."""
    least, most, top = float(values.min()), float(values.max()), white(values)
    if most - least >= LEAST_SHARE * top:
        return None
    return f"{least:g} to {most:g} of 0 to {top:g}"


def choose_pictures(
    paths: Iterable[Path], suffixes: tuple[str, ...] = SUFFIXES
) -> tuple[list[Path], Counter[str]]:
    """Choose pictures by the names of their files.

    Args:
        paths: paths of anything in a folder.
        suffixes: endings of pictures, in lower case.

    Returns:
        The pictures, and the number of the others by their kind.
    """
    chosen, others = [], Counter[str]()
    for path in paths:
        kind = _other_kind(path, suffixes)
        if kind is None:
            chosen.append(path)
        else:
            others[kind] += 1
    return chosen, others


def in_words(others: Mapping[str, int]) -> str:
    """Return numbers of files by their kind, such as ``2 hidden, 30 .heic``."""
    return ", ".join(f"{count} {kind}" for kind, count in sorted(others.items()))


def is_hidden(path: Path) -> bool:
    """Return whether a file or folder belongs to the system, by its name."""
    return path.name.startswith((".", "__MACOSX")) or path.name.lower() in (
        *("thumbs.db", "desktop.ini"),
        *("@eadir", "#recycle", "$recycle.bin"),
    )


def _other_kind(path: Path, suffixes: tuple[str, ...]) -> str | None:
    if is_hidden(path):
        return "hidden"
    if path.is_dir():
        return "linked folder" if path.is_symlink() else "folder"
    if not path.is_file():
        return "broken link" if path.is_symlink() else "special file"
    if path.suffix.lower() not in suffixes:
        return ascii(path.suffix.lower())[1:-1][:12] or "without suffix"
    return None


def _content(path: Path) -> bytes:
    try:
        if not path.is_file():
            path.stat()  # tells why, where there is nothing
            raise PictureError("is not a file: give a picture")
        with path.open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise PictureError(f"cannot be read ({error.strerror}): check it") from None
    if len(content) > MAX_BYTES:
        raise PictureError(f"has more than {MAX_BYTES >> 20} MiB: use a smaller picture")
    return content


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split()).encode("ascii", "backslashreplace").decode()
    return text[:120] or type(error).__name__


def _without_metadata(content: bytes) -> tuple[bytes, int]:
    """Return a file without metadata that Pillow would read, and the orientation in it."""
    if content.startswith(b"\xff\xd8"):
        return _bare_jpeg(content)
    order = _order(content)
    return (content, 1) if order is None else _bare_tiff(content, order)


def _bare_jpeg(content: bytes) -> tuple[bytes, int]:
    """As above; of application segments, those of JFIF and Adobe tell the colours and stay."""
    kept, place, orientation = [content[:2]], 2, 1
    while content[place : place + 1] == b"\xff" and place + 4 <= len(content):
        marker, end = content[place + 1], place + 2
        if marker == 0xFF:  # fill bytes
            place += 1
            continue
        if marker == 0xDA:  # pixels
            break
        if not 0xD0 <= marker <= 0xD8:
            end += int.from_bytes(content[end : end + 2], "big")
        segment = content[place:end]
        if marker == 0xE1 and segment[4:10] == b"Exif\0\0" and orientation == 1:
            orientation = _orientation(segment[10:])
        if not 0xE0 < marker < 0xF0 or marker == 0xEE:
            kept.append(segment)
        place = end
    return b"".join(kept) + content[place:], orientation


def _bare_tiff(content: bytes, order: Order) -> tuple[bytes, int]:
    """As above; the tags stay in their ascending order, under numbers that mean nothing."""
    bare = bytearray(content)
    for place, tag in _entries(content, order):
        if tag == _ORIENTATION:
            upright = (3).to_bytes(2, order) + (1).to_bytes(4, order) + (1).to_bytes(2, order)
            bare[place + 2 : place + 12] = upright + bytes(2)
        elif tag in (_XMP, _EXIF, _GPS):
            bare[place : place + 2] = (tag - 1).to_bytes(2, order)
    return bytes(bare), _orientation(content)


def _order(tiff: bytes) -> Order | None:
    orders: dict[bytes, Order] = {b"II*\0": "little", b"MM\0*": "big"}
    return orders.get(tiff[:4])


def _entries(tiff: bytes, order: Order) -> Iterable[tuple[int, int]]:
    """Return place and tag of whole entries in the first directory of TIFF data."""
    start = int.from_bytes(tiff[4:8], order)
    count = int.from_bytes(tiff[start : start + 2], order)
    for place in range(start + 2, min(start + 2 + 12 * count, len(tiff) - 11), 12):
        yield place, int.from_bytes(tiff[place : place + 2], order)


def _orientation(tiff: bytes) -> int:
    """Return the orientation that EXIF data tell, 1 to 8; 1 where they do not."""
    order = _order(tiff)
    if order is None:
        return 1
    for place, tag in _entries(tiff, order):
        if tag == _ORIENTATION:
            size = _SIZES.get(int.from_bytes(tiff[place + 2 : place + 4], order), 0)
            value = int.from_bytes(tiff[place + 8 : place + 8 + size], order)
            return value if 1 <= value <= 8 else 1
    return 1


def _decoded(content: bytes, most: int) -> tuple[Values, bytes]:
    """Return the pixels as they are stored, and the EXIF data of a PNG or WebP file."""
    from PIL import Image, UnidentifiedImageError  # noqa: PLC0415 - only who reads files needs it

    # Of metadata and of sizes; sizes are checked here.
    warnings.filterwarnings("ignore", module="PIL")
    try:
        image = Image.open(io.BytesIO(content), formats=FORMATS)
    except UnidentifiedImageError:
        raise PictureError(f"is no image, or damaged, or of another format: use {KINDS}") from None
    except Image.DecompressionBombError:
        raise PictureError(f"has too many pixels: use at most {most}") from None
    with image:
        pixels = image.width * image.height
        if pixels > most or not pixels:
            raise PictureError(f"has {pixels} pixels: use at most {most}, and at least 1")
        bits = _bits(image)
        image.load()
        exif = image.info.get("exif")
        return _values(image, bits), exif if isinstance(exif, bytes) else b""


def _bits(image: ImageFile) -> int:
    """Return the bits of a channel in the file; Pillow keeps 8 of them in most modes."""
    tags = getattr(image, "tag_v2", None)
    if tags is not None:
        return int(max(tags.get(258, (1,))))
    deep = image.format == "PNG" and any(";16" in str(tile[3]) for tile in image.tile)
    return 16 if deep else 8


def _values(image: Image.Image, bits: int) -> Values:
    if image.mode.startswith("I"):
        return _deep(image, bits)
    if image.mode == "F":
        values = np.array(image, dtype=np.float32)
        if not bool(np.isfinite(values).all()):
            raise PictureError("holds NaN or infinity: use finite numbers")
        return values
    if bits > 8:
        raise PictureError(
            f"has {bits} bits a channel with colour or transparency, and 8 would be lost: save it "
            "in gray without transparency, or with 8 bits"
        )
    if image.mode not in (*_GRAYS, *_COLOURS):
        raise PictureError(f"has the colours {image.mode}: save it in RGB or gray")
    if image.has_transparency_data:
        shown = np.asarray(image.convert("RGBA")).astype(np.uint16)
        values = ((shown[..., :3] * shown[..., 3:] + 127) // 255).astype(np.uint8)
    elif image.mode in _GRAYS:
        return np.array(image.convert("L"))
    else:
        values = np.array(image.convert("RGB"))
    # A palette of grays, as most GIF files have it, is no colour.
    gray = image.mode in _GRAYS or (image.mode == "P" and bool((values == values[..., :1]).all()))
    return np.ascontiguousarray(values[..., 0]) if gray else values


def _deep(image: Image.Image, bits: int) -> npt.NDArray[np.uint16]:
    """Return more than 8 bits of gray, the largest number being white."""
    stored = np.asarray(image)
    if stored.min() < 0 or stored.max() > 65535:
        raise PictureError("holds numbers outside 0 to 65535: save it with 16 bits")
    values = stored.astype(np.uint16)
    clear = image.info.get("transparency")
    if isinstance(clear, int):
        values[values == clear] = 0
    return (values << 4 | values >> 8).astype(np.uint16) if bits == 12 else values
