"""Arrays on the wire in NumPy: checked, listed, as files, and drawn."""

from __future__ import annotations

import io
import re
import struct
import zlib
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from pydantic_core import CoreSchema, core_schema

Float32: TypeAlias = npt.NDArray[np.float32]
_NPY = re.compile(
    rb"\x93NUMPY[\x01-\x03]\x00..(?:..)?\{'descr': '<f4', 'fortran_order': False, "
    rb"'shape': \(([0-9, ]{1,99})\), \} *\n",
    re.DOTALL,
)
"""The header that NumPy writes; any other one is none of a daemon's."""
_PICTURE = 256
"""Rows or columns that a picture has at least, so that its pixels are seen [pixels]."""
_DARKEST, _GREYS = 232, 24
"""The first grey of the 256 colours of a terminal (xterm), and how many there are."""


def npy_bytes(picture: npt.ArrayLike) -> bytes:
    """Return a picture as a ``.npy`` file; raises ValueError for any other object."""
    buffer = io.BytesIO()
    pixels = np.asarray(picture)
    if pixels.dtype.kind not in "buif" or pixels.ndim not in (2, 3):
        raise ValueError("a picture is an array of numbers with 2 or 3 axes")
    np.save(buffer, pixels, allow_pickle=False)
    return buffer.getvalue()


class _Overwritten(bytearray):
    """Memory that is filled with zeros as the last array in it goes."""

    def __del__(self) -> None:
        self[:] = bytes(len(self))


def erasable(values: npt.NDArray[Any], dtype: npt.DTypeLike = np.float32) -> npt.NDArray[Any]:
    """Return a copy that is overwritten as soon as nobody holds it any more."""
    kind = np.dtype(dtype)
    held = np.frombuffer(_Overwritten(values.size * kind.itemsize), kind).reshape(values.shape)
    held[...] = values
    return held


def list_schema(numbers: CoreSchema) -> CoreSchema:
    """Return how pydantic reads and writes a flat array of float32.

    Args:
        numbers: format of a list of numbers, which the array is in JSON.
    """
    listed = core_schema.no_info_after_validator_function(_held, numbers)
    given = core_schema.no_info_after_validator_function(
        _held, core_schema.is_instance_schema(np.ndarray)
    )
    return core_schema.json_or_python_schema(
        json_schema=listed,
        python_schema=core_schema.union_schema([given, listed]),
        serialization=core_schema.plain_serializer_function_ser_schema(
            _listed, return_schema=numbers
        ),
    )


def _held(values: npt.NDArray[Any] | tuple[float, ...]) -> Float32:
    given = np.asarray(values)
    if given.dtype != np.float32:
        given = given.astype(np.float64)
    if given.ndim != 1 or not np.isfinite(given).all():
        raise ValueError("values are finite float32, one after the other")
    with np.errstate(over="ignore"):
        held = erasable(given)
    # What is signed or logged is what was written: nothing is rounded on the way.
    if not (held == given).all():
        raise ValueError("values are float32: there is a number that no camera sends")
    held.flags.writeable = False
    return held


def _listed(values: Float32) -> tuple[float, ...]:
    return tuple(values.tolist())


def npy_array(content: bytes) -> Float32:
    """Array in the bytes of a ``.npy`` file, not to be written to.

    Raises:
        ValueError: it is not one of float32 in the order of C, or not whole.
    """
    header = _NPY.match(content)
    if header is None:
        raise ValueError("this is no NumPy file of float32")
    shape = tuple(map(int, header[1].rstrip(b",").split(b",")))
    return np.frombuffer(content, "<f4", offset=header.end()).reshape(shape)


def converted(held: Float32, dtype: npt.DTypeLike | None, copy: bool | None) -> npt.NDArray[Any]:
    """Return the result of ``__array__`` for an array that is not to be written to."""
    if copy is False:
        if dtype is not None and np.dtype(dtype) != held.dtype:
            raise ValueError(f"float32 cannot become {np.dtype(dtype)} without a copy")
        return held
    return np.array(held, dtype)


def flat(values: Float32) -> npt.NDArray[np.float64]:
    """Return (rows, columns) of numbers in one row, (rows, columns), or channels side by side."""
    planes = values.reshape(-1, *np.atleast_2d(values).shape[-2:])
    return np.concatenate(planes.astype(float), axis=1)


def picture(values: Float32) -> bytes:
    """PNG of an array of :func:`flat`, from black to white."""
    across = flat(values)
    low, high = across.min(), across.max()
    grey = np.rint((across - low) * (255 / ((high - low) or 1.0))).astype(np.uint8)
    scale = max(1, _PICTURE // max(grey.shape))
    return _png(grey.repeat(scale, 0).repeat(scale, 1))


def _png(grey: npt.NDArray[np.uint8]) -> bytes:
    """PNG (ISO/IEC 15948) of 8 bits, without a filter."""
    rows, columns = grey.shape
    lines = np.concatenate([np.zeros((rows, 1), np.uint8), grey], axis=1).tobytes()
    parts = (
        (b"IHDR", struct.pack(">2I5B", columns, rows, 8, 0, 0, 0, 0)),
        (b"IDAT", zlib.compress(lines)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in parts
    )


def in_blocks(values: Float32) -> str:
    """Draw an array for a terminal, two values a character; the smallest value is the darkest.

    Args:
        values: (rows, columns), or (channels, rows, columns), which are drawn side by side.
    """
    across = flat(values)
    low, high = across.min(), across.max()
    greys = _DARKEST + np.rint((across - low) * ((_GREYS - 1) / ((high - low) or 1.0))).astype(int)
    if len(greys) % 2:
        greys = np.concatenate([greys, np.full_like(greys[:1], _DARKEST)])
    return "\n".join(
        "".join(
            f"\x1b[38;5;{upper};48;5;{lower}m▀" for upper, lower in zip(above, below, strict=True)
        )
        + "\x1b[0m"
        for above, below in zip(greys[::2], greys[1::2], strict=True)
    )
