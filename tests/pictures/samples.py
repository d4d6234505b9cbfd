"""Pictures of every format and with every defect, and what must come of each.

A picture that can be read shows four squares. Their levels are told row by row, white being 1.
"""

from __future__ import annotations

import io
import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

SIDE = 32
GRAY = (1.0, 0.8, 0.4, 0.0)
COLOURS = ((255, 255, 255), (255, 0, 0), (0, 255, 0), (0, 0, 0))
LUMA = (1.0, 0.299, 0.587, 0.0)
FINE = (1.0, 0.5, 0.5 + 300 / 65535, 0.0)

Pixels = npt.NDArray[Any]


@dataclass(frozen=True)
class Sample:
    """A file, and either the levels that it shows or the words that refuse it."""

    name: str
    content: bytes
    levels: tuple[float, ...] = ()
    refusal: str = ""
    tolerance: float = 0.03
    warned: bool = False


def squares(levels: Any) -> Pixels:
    cells = np.asarray(levels)
    cells = cells.reshape(2, 2, *cells.shape[1:])
    return cells.repeat(SIDE // 2, 0).repeat(SIDE // 2, 1)


def saved(pixels: Pixels | Image.Image, kind: str, **options: Any) -> bytes:
    image = pixels if isinstance(pixels, Image.Image) else Image.fromarray(pixels)
    stream = io.BytesIO()
    image.save(stream, kind, **options)
    return stream.getvalue()


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(columns: int, rows: int, bits: int, kind: int, lines: bytes) -> bytes:
    header = struct.pack(">IIBBBBB", columns, rows, bits, kind, 0, 0, 0)
    parts = (chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(lines)), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def entry(tag: int, kind: int, count: int, value: bytes) -> bytes:
    return struct.pack("<HHI", tag, kind, count) + value.ljust(4, b"\0")


def exif(orientation: int) -> bytes:
    first = struct.pack("<H", 2) + entry(0x0112, 3, 1, struct.pack("<H", orientation))
    first += entry(0x8825, 4, 1, struct.pack("<I", 38)) + struct.pack("<I", 0)
    gps = struct.pack("<H", 1) + entry(0x0000, 2, 1, b"\0") + struct.pack("<I", 0)
    return b"Exif\0\0II*\0" + struct.pack("<I", 8) + first + gps


def with_exif(jpeg: bytes, data: bytes) -> bytes:
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(data) + 2) + data + jpeg[2:]


def turned(pixels: Pixels) -> Pixels:
    return np.ascontiguousarray(np.rot90(pixels, 1))


def tiff(pixels: Pixels, tags: dict[int, int]) -> bytes:
    """Return a TIFF file of little endian with tags in its first directory."""
    rows, columns = pixels.shape[:2]
    data = pixels.tobytes()
    bits = 8 * pixels.dtype.itemsize
    plain = {256: columns, 257: rows, 258: bits, 259: 1, 262: 1, 273: 8, 277: 1, 278: rows}
    every = sorted({**plain, 279: len(data), 339: 1, **tags}.items())
    directory = struct.pack("<H", len(every))
    directory += b"".join(entry(tag, 4, 1, struct.pack("<I", value)) for tag, value in every)
    return b"II*\0" + struct.pack("<I", 8 + len(data)) + data + directory + bytes(4)


def levels(picture: npt.NDArray[np.float64]) -> list[float]:
    half = picture.shape[0] // 2
    starts = (half // 4, half + half // 4)
    return [
        float(picture[top : top + half // 2, left : left + half // 2].mean())
        for top in starts
        for left in starts
    ]


def make_samples() -> tuple[Sample, ...]:
    gray = np.round(255 * squares(GRAY)).astype(np.uint8)
    colour = squares(COLOURS).astype(np.uint8)
    fine = np.round(65535 * squares(FINE)).astype(np.uint16)
    big = np.ascontiguousarray(fine.astype(">u2"))
    other = Image.fromarray(255 - gray)
    jpeg = saved(colour, "JPEG", quality=95, subsampling=0)
    lying = saved(turned(colour), "JPEG", quality=95, subsampling=0)
    clear = np.dstack([np.full((SIDE, SIDE, 3), 255, np.uint8), gray])
    palette = Image.fromarray(colour).convert("P", palette=Image.Palette.ADAPTIVE, colors=4)
    deep_colour = np.repeat(big[..., None], 3, axis=2)
    lines = b"".join(b"\0" + line.tobytes() for line in deep_colour)
    behind = 20_000  # beyond the end of the file
    white = int(np.argmax(np.asarray(palette.getpalette()).reshape(-1, 3)[:4].sum(1)))
    return (
        Sample("gray.png", saved(gray, "PNG"), GRAY),
        Sample("colour.jpg", jpeg, LUMA),
        Sample(
            "phone.jpg",
            saved(
                Image.fromarray(turned(colour)),
                "MPO",
                quality=95,
                subsampling=0,
                save_all=True,
                append_images=[other.convert("RGB")],
                exif=exif(6),
            ),
            LUMA,
        ),
        Sample("colour.webp", saved(colour, "WEBP", lossless=True), LUMA),
        Sample("turned.webp", saved(turned(colour), "WEBP", lossless=True, exif=exif(6)), LUMA),
        Sample("colour.bmp", saved(colour, "BMP"), LUMA),
        Sample("packed.tif", saved(colour, "TIFF", compression="tiff_lzw"), LUMA),
        Sample("turned.png", saved(turned(gray), "PNG", exif=exif(6)), GRAY),
        Sample("moving.gif", saved(gray, "GIF", save_all=True, append_images=[other]), GRAY),
        Sample(
            "moving.webp",
            saved(gray, "WEBP", lossless=True, save_all=True, append_images=[other]),
            GRAY,
        ),
        Sample("two-pages.tiff", saved(gray, "TIFF", save_all=True, append_images=[other]), GRAY),
        Sample("palette.png", saved(palette, "PNG"), LUMA),
        Sample("clear-palette.png", saved(palette, "PNG", transparency=white), (0.0, *LUMA[1:])),
        Sample("clear.png", saved(clear, "PNG"), GRAY),
        Sample(
            "bits.png",
            saved(Image.fromarray(gray).convert("1", dither=Image.Dither.NONE), "PNG"),
            (1.0, 1.0, 0.0, 0.0),
        ),
        Sample(
            "print.jpg",
            saved(Image.fromarray(colour).convert("CMYK"), "JPEG", quality=95, subsampling=0),
            LUMA,
        ),
        Sample("deep.png", saved(fine, "PNG"), FINE, tolerance=1e-5),
        Sample("deep.tif", saved(fine, "TIFF"), FINE, tolerance=1e-5),
        Sample(
            "deep-big-endian.tif",
            saved(Image.frombytes("I;16B", (SIDE, SIDE), big.tobytes()), "TIFF"),
            FINE,
            tolerance=1e-5,
        ),
        Sample(
            "whole.tif", saved(Image.fromarray(fine.astype(np.int32)), "TIFF"), FINE, tolerance=1e-5
        ),
        Sample("float.tif", saved(squares(FINE).astype(np.float32), "TIFF"), FINE, tolerance=1e-5),
        Sample("gps.jpg", with_exif(lying, exif(6)), LUMA),
        Sample("cut-exif.jpg", with_exif(lying, exif(6)[:35]), LUMA),
        Sample("empty-exif.jpg", with_exif(jpeg, b"Exif\0\0"), LUMA),
        Sample("odd-exif.jpg", with_exif(jpeg, b"Exif\0\0MM\0*\xff\xff\xff\xff"), LUMA),
        Sample("gps.tif", tiff(turned(gray), {0x0112: 6, 0x8825: behind, 0x8769: behind}), GRAY),
        Sample(
            "dark.png",
            saved((fine >> 4).astype(np.uint16), "PNG"),
            tuple(level / 16 for level in FINE),
            tolerance=2e-5,
            warned=True,
        ),
        Sample(
            "flat.bmp", saved(np.full((SIDE, SIDE), 51, np.uint8), "BMP"), (0.2,) * 4, warned=True
        ),
        Sample("deep-colour.png", png(SIDE, SIDE, 16, 2, lines), refusal="16 bits"),
        Sample(
            "large.tif",
            saved(Image.fromarray(fine.astype(np.int32) * 9), "TIFF"),
            refusal="numbers outside 0 to 65535",
        ),
        Sample(
            "counts.tif",
            saved((900 * squares(FINE)).astype(np.float32), "TIFF"),
            refusal="reflectances|numbers outside 0 to 1",
        ),
        Sample("nan.tif", saved(np.full((SIDE, SIDE), np.nan, np.float32), "TIFF"), refusal="NaN"),
        Sample("cut.png", saved(colour, "PNG")[:-30], refusal="damaged"),
        Sample("cut.jpg", jpeg[: len(jpeg) // 2], refusal="damaged"),
        Sample("empty.png", b"", refusal="no image"),
        Sample("text.jpg", b"<html>not found</html>", refusal="no image"),
        Sample("apple.jpg", b"\0\0\0\x18ftypheic" + bytes(200), refusal="another format"),
        Sample("nothing.png", png(0, 8, 8, 0, b""), refusal="pixels|no image|damaged"),
        Sample("bomb.png", png(60_000, 60_000, 8, 0, bytes(9)), refusal="pixels: use|too many"),
    )
