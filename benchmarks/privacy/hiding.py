"""Hiding of masks: what an eye sees, a machine recognises and reads, and which masks are refused.

``python -m benchmarks.privacy.hiding --data data/mnist --figures benchmarks/results/hiding.json``

Shipped masks, random masks and one pinhole on MNIST; a reader at four sizes; and masks of many
kinds before the check of a daemon, in gray (24 x 32) and in colour (27 x 36).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
import torch
import typer
from benchmarks.figures import FiguresOption, record

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.transfer.conditioning import ConditioningMeter
from veilcam_server.bundles.hiding import LEAST
from veilcam_server.demo_data import BUNDLE
from veilcam_training.bundle import read_bundle, sentences, shows
from veilcam_training.data import open_source
from veilcam_training.hiding.eye import drawn_eye
from veilcam_training.hiding.measuring import measure
from veilcam_training.hiding.pinholes import Measurer
from veilcam_training.hiding.reader import Reader, scenes_of
from veilcam_training.hiding.scenes import random_masks

Mask = npt.NDArray[np.float32]

SIZES = ("24x32", "12x16", "6x8", "3x4")
HOLES = (1, 2, 3, 5, 8, 15, 30, 50)
GROUNDS = (10, 20, 30, 40, 50)
COLOUR = Scene(rows=32, columns=32, height=0.25, distance=0.4)

app = typer.Typer(pretty_exceptions_enable=False)


def kinds(camera: Camera, count: int) -> Iterator[tuple[str, list[Mask]]]:
    """Masks by their kind; a hole is one open sub-pixel of each colour."""
    rows, columns = camera.mask_shape
    random = np.random.default_rng(1)

    def holes(number: int, ground: Mask) -> Mask:
        mask = ground.copy()
        for _ in range(number):
            top, column = random.integers(rows - 2), random.integers(columns)
            mask[top : top + 3, column] = 1
        return mask

    def drawn() -> Mask:
        return random.random((rows, columns), np.float32)

    dark = np.zeros((rows, columns), np.float32)
    for number in HOLES:
        yield f"{number} holes", [holes(number, dark) for _ in range(count)]
    for ground in GROUNDS:
        even = np.full_like(dark, ground / 100)
        yield f"hole in {ground} % even", [holes(1, even) for _ in range(count)]
    for ground in GROUNDS:
        yield (
            f"hole in {ground} % random",
            [holes(1, np.float32(ground / 100) * drawn()) for _ in range(count)],
        )
    along, across = np.arange(rows)[:, None], np.arange(columns)[None]

    def stripes(places: npt.NDArray[np.int64]) -> Mask:
        period = random.integers(2, 13)
        lit = (places + random.integers(period)) % period < period / 2
        return np.broadcast_to(lit, dark.shape).astype(np.float32)

    yield "stripes across", [stripes(along) for _ in range(count)]
    yield "stripes along", [stripes(across) for _ in range(count)]
    yield (
        "stripes random",
        [
            np.repeat(random.random((rows, 1)) < 0.5, columns, 1).astype(np.float32)
            for _ in range(count)
        ],
    )
    yield (
        "halves",
        [
            np.broadcast_to(along < random.integers(rows // 3, 2 * rows // 3), dark.shape).astype(
                np.float32
            )
            for _ in range(count)
        ],
    )
    yield "open", [1 - np.float32(0.2 * random.random()) * drawn() for _ in range(count)]
    yield "big hole", [_disc(along, across, random) for _ in range(count)]
    yield "random", [drawn() for _ in range(count)]


def _disc(
    along: npt.NDArray[np.int64], across: npt.NDArray[np.int64], random: np.random.Generator
) -> Mask:
    y, x = random.uniform(15, 35), random.uniform(7, 15)
    distance = np.square((along - y) * 0.073) + np.square((across - x) * 0.219)
    mask: Mask = (distance < random.uniform(0.25, 1.0) ** 2).astype(np.float32)
    return mask


@app.command()
def run(
    *,
    data: Annotated[Path, typer.Option(help="Folder with MNIST.")],
    count: Annotated[int, typer.Option(min=1, help="Masks of each kind.")] = 40,
    readers: Annotated[bool, typer.Option(help="Train a reader for each size.")] = True,
    figures: FiguresOption = None,
) -> None:
    """Print all figures, and write them down."""
    torch.set_num_threads(1)
    values = shipped(data)
    if readers:
        values |= read(data)
    values |= table("gray", Scene(), Embedding(24, 32), 1, count)
    values |= table("colour", COLOUR, Embedding(27, 36), 3, count)
    for name, value in values.items():
        print(f"{name}: {value:.4g}")
    record(figures, values)


def shipped(data: Path) -> dict[str, float]:
    """Figures of the masks that come along."""
    source, bundle = open_source("mnist", data), read_bundle(BUNDLE)
    found = measure(bundle, source.training(), source.test())
    print(*sentences(found), sep="\n")
    return {
        "shipped_seen_worst": found.seen,
        "random_seen": found.random_seen,
        "pinhole_seen": found.pinhole_seen,
        "shipped_recognised": found.recognised,
        "random_recognised": found.random_recognised,
        "shipped_read": found.read or 0.0,
        "random_read": found.random_read or 0.0,
    }


def read(data: Path) -> dict[str, float]:
    """Shares of digits that are read behind random masks, by size."""
    source, camera = open_source("mnist", data), Camera()
    training, test = source.training(), source.test()
    values = {}
    for size in SIZES:
        rows, columns = map(int, size.split("x"))
        embedding = Embedding(rows, columns)
        measurer = Measurer(camera, source.scene, embedding, 1)
        reader = Reader(camera, embedding, measurer, training, len(source.labels))
        shares = [
            reader.read(measurer(scenes_of(test, slice(0, 1000)), mask), test.labels[:1000])
            for mask in random_masks(camera)
        ]
        values[f"read_{size}"] = float(np.mean(shares))
    return values


def table(
    name: str, scene: Scene, embedding: Embedding, channels: Literal[1, 3], count: int
) -> dict[str, float]:
    """Share of each kind of mask that a daemon refuses, and the time that one mask takes."""
    camera = Camera()
    meter, eye = (
        ConditioningMeter(camera, scene, embedding),
        drawn_eye(camera, scene, embedding, channels),
    )
    values, begun, looked = {}, time.process_time(), 0
    for kind, masks in kinds(camera, count):
        blurred = [meter.directions(mask) < LEAST for mask in masks]
        # An eye looks where the other check does not refuse, as in a daemon.
        seen = [eye.seen(mask) for mask, blur in zip(masks, blurred, strict=True) if not blur]
        looked += len(seen)
        refused = sum(blurred) + sum(shows(share, eye.random, eye.pinhole) for share in seen)
        told = f"{np.mean(seen):.3f} ({min(seen):.3f} to {max(seen):.3f})" if seen else "-"
        print(
            f"{name}: {kind}: refused {refused} of {count}, {sum(blurred)} as blur; seen {told}",
            flush=True,
        )
        values[f"{name}_refused_{kind.replace(' %', '').replace(' ', '_')}"] = refused / count
    values[f"{name}_mask_s"] = (time.process_time() - begun) / max(1, looked)
    return values


if __name__ == "__main__":
    app()
