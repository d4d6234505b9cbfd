"""``python -m veilcam_server.demo_data.make``: ``mnist-sample.npz`` from the MNIST test files.

Only the t10k files are read: what the demonstration shows was never trained on.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from pathlib import Path
from typing import Annotated, NoReturn

import numpy as np
import numpy.typing as npt
import typer

from veilcam_server.demo_data import DIGITS

IMAGES, LABELS = "t10k-images-idx3-ubyte.gz", "t10k-labels-idx1-ubyte.gz"
SEED = 2022


def make(
    mnist: Annotated[Path, typer.Option(help=f"Directory with {IMAGES} and {LABELS}.")],
    out: Annotated[Path, typer.Option(help="File to write.")] = DIGITS,
    count: Annotated[int, typer.Option(min=1, max=10_000, help="How many digits.")] = 5_000,
) -> None:
    """Draw digits from the MNIST test set without replacement, by a fixed seed."""
    images, labels = read_idx(mnist / IMAGES), read_idx(mnist / LABELS)
    if images.ndim != 3 or labels.shape != images.shape[:1] or len(labels) < count:
        _fail(f"{mnist} holds no {count} images with labels: use the MNIST test files")
    chosen = np.sort(np.random.default_rng(SEED).choice(len(labels), count, replace=False))
    np.savez_compressed(out, images=images[chosen], labels=labels[chosen])
    typer.echo(f"{count} digits of the test set in {out}, {out.stat().st_size / 1e6:.2f} MB")


def read_idx(path: Path) -> npt.NDArray[np.uint8]:
    """Read a gzipped idx file of unsigned bytes (LeCun's format: 0, 0, 8, rank, then the sides)."""
    try:
        data = gzip.decompress(path.read_bytes())
        if data[:3] != b"\0\0\x08":
            raise ValueError("no unsigned bytes")
        rank = data[3]
        shape = struct.unpack(f">{rank}I", data[4 : 4 + 4 * rank])
        return np.frombuffer(data, np.uint8, offset=4 + 4 * rank).reshape(shape)
    except FileNotFoundError:
        _fail(f"there is no {path}: give the directory that holds the MNIST test files")
    except (OSError, EOFError, zlib.error, ValueError, IndexError, struct.error):
        _fail(f"{path} is not a gzipped idx file: get it again")


def _fail(message: str) -> NoReturn:
    typer.echo(f"error: {message}", err=True)
    raise SystemExit(1)


if __name__ == "__main__":
    typer.run(make)
