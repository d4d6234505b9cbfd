"""How far masks that hide and masks that hide nothing lie from the floors of a daemon.

``python -m benchmarks.privacy.conditioning --count 200 --fits runs/conditioning
--figures benchmarks/results/conditioning.json``

Taken: masks that keys draw (weights ``u``, ``u^4``, ``u^10``) at four embeddings, those of the
bundles that come along, and those of fits. Refused: one, two or three open pixels
anywhere, black or dim around them; open windows with noise, a half, a gradient.

The fits of the record, ``veilcam-train fit --data data/mnist --threads 1 --recipe best``:

- ``--classifier LR --epochs 3 --seed 1`` at 3x4, 6x8 and 24x32;
- ``--seed 2``: 3x4 LR, 60 epochs; 6x8 LR with ``--recipe paper``, 8; 12x16 FC800, 8;
- ``--change shift --classifier FC800``: 24x32, 1 epoch (seed 1); 3x4, 10 (seed 2); 12x16, 6 (seed
  2) and 30 (seed 3);
- ``--change rescale --classifier LR --epochs 4 --seed 2`` at 6x8.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import torch
import typer
from benchmarks.figures import FiguresOption, record
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.keys.masks import KEY_BYTES, MaskDistribution, draw_levels
from veilcam_optics.transfer.conditioning import Conditioning, ConditioningMeter
from veilcam_server.bundles.hiding import LEAST, HidingCheck
from veilcam_server.demo_data import BUNDLE, FRESH
from veilcam_server.errors import BundleRevealsError
from veilcam_training.bundle import read_bundle

EMBEDDINGS = (Embedding(3, 4), Embedding(6, 8), Embedding(12, 16), Embedding(24, 32))
MEASURES = ("directions", "spread", "own")

app = typer.Typer(pretty_exceptions_enable=False)


def drawn(camera: Camera, exponent: float, count: int) -> Iterator[npt.NDArray[np.float32]]:
    """Masks that keys draw, a key for each."""
    distribution, random = MaskDistribution.power(camera, exponent), np.random.default_rng(1)
    for _ in range(count):
        key = random.bytes(KEY_BYTES)
        levels = draw_levels(key, camera=camera, distribution=distribution)
        yield to_weights(levels, camera.panel)


def hiding_nothing(camera: Camera, count: int) -> Iterator[tuple[str, Tensor]]:
    """Masks by their kind."""
    rows, columns = camera.mask_shape
    generator = torch.Generator().manual_seed(1)

    def anywhere(count: int) -> int:
        return int(torch.randint(count, (1,), generator=generator))

    for holes in (1, 2, 3):
        for number in range(count):
            mask = 0.05 * (number % 2) * torch.rand(rows, columns, generator=generator)
            for _ in range(holes):
                row, column = anywhere(rows - 2), anywhere(columns)
                mask[row : row + 3, column] = 1
            yield f"{holes} open", mask
    for depth in (0.0, 0.02, 0.1, 0.2):
        for _ in range(count if depth else 1):
            yield "open window", 1 - depth * torch.rand(rows, columns, generator=generator)
    along, across = torch.linspace(0, 1, rows)[:, None], torch.linspace(0, 1, columns)[None]
    for ramp in (along.expand(rows, columns), across.expand(rows, columns)):
        yield "gradient", ramp.clone()
        yield "half", (ramp < 0.5).float()


def is_taken(found: Conditioning) -> bool:
    """Whether a daemon takes this mask."""
    return all(getattr(found, name) >= getattr(LEAST, name) for name in MEASURES)


@app.command()
def measure(
    *,
    fits: Annotated[Path | None, typer.Option(help="Folder with bundles of training.")] = None,
    count: Annotated[int, typer.Option(min=1, help="Masks of each kind.")] = 100,
    figures: FiguresOption = None,
) -> None:
    """Print the least of what is taken, and what part of the rest is refused."""
    camera, values = Camera(), {}
    taken: list[Conditioning] = []
    for embedding in EMBEDDINGS:
        meter = ConditioningMeter(camera, Scene(), embedding)
        begun = time.perf_counter()
        for exponent in (1.0, 4.0, 10.0):
            taken += [meter(mask) for mask in drawn(camera, exponent, count)]
        values["conditioning_ms"] = 1e3 * (time.perf_counter() - begun) / (3 * count)
        kinds: dict[str, list[bool]] = {}
        for kind, mask in hiding_nothing(camera, count):
            kinds.setdefault(kind, []).append(not is_taken(meter(mask.numpy())))
        for kind, refused in kinds.items():
            share = sum(refused) / len(refused)
            print(f"{embedding}: {kind}: {share:.3f} of {len(refused)} refused")
            name = f"conditioning_refused_{kind.replace(' ', '_')}"
            values[name] = min(share, values.get(name, 1.0))
    values |= {f"conditioning_drawn_{name}": _least(taken, name) for name in MEASURES}
    learned, fitted = [], [] if fits is None else sorted(fits.glob("*.veilcam"))
    for path in (BUNDLE, *fitted):
        bundle = read_bundle(path)
        meter = ConditioningMeter(bundle.camera, bundle.scene, bundle.embedding)
        found = [meter(to_weights(pair.levels, bundle.camera.panel)) for pair in bundle.pairs]
        print(path.name, *(f"{name} {_least(found, name):.3f}" for name in MEASURES))
        learned += found
    values |= {f"conditioning_learned_{name}": _least(learned, name) for name in MEASURES}
    values["conditioning_learned_masks"] = len(learned)
    for path in (BUNDLE, FRESH, *fitted):
        bundle = read_bundle(path)
        begun = time.perf_counter()
        try:
            HidingCheck(bundle)(bundle)
        except BundleRevealsError as error:
            print(f"{path}: {error}")
        if path == FRESH:
            values["conditioning_open_ms"] = 1e3 * (time.perf_counter() - begun)
    for name, value in values.items():
        print(f"{name}: {value:.4g}")
    record(figures, values)


def _least(found: list[Conditioning], name: str) -> float:
    return float(min(getattr(each, name) for each in found))


if __name__ == "__main__":
    app()
