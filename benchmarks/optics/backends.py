"""How far NumPy, which the device computes in, is from torch, which training computes in.

``numpy_torch_max_difference`` is the largest difference, in float64, of

- transfer matrices, as a share of the largest entry;
- decoded scenes, whose brightness lies from 0 to 1;

over every preset camera, with one sub-pixel column of interference and none, straight and turned,
behind masks that are random, all open, one hole, and half of it dead. The time that NumPy takes
over torch's, to prepare an epoch in the precision of the daemon, is printed beside it: one thread,
taking turns.

    python -m benchmarks.optics.backends --figures benchmarks/results/optics.json
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.optics.step import take_turns
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.camera.presets import PRESETS
from veilcam_optics.decoding import Precision, SceneDecoding, SceneStatistics, fit_statistics
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.product import Transfer
from veilcam_optics.transfer.tables import Reach

Values = npt.NDArray[Any]
SCENES = 2000


def in_numpy(decoding: SceneDecoding) -> SceneDecoding[Transfer[Values]]:
    """The same tables and statistics, as arrays of NumPy."""
    operator, known = decoding.operator, decoding.statistics
    tables = {name: table.numpy() for name, table in operator.transfer.arrays().items()}
    return SceneDecoding(
        Transfer.from_arrays(operator.camera, operator.scene, operator.embedding, tables),
        SceneStatistics(known.mean.numpy(), known.basis.numpy(), known.residual.numpy()),
        decoding.noise,
        precision=decoding.precision,
    )


def blobs(scene: Scene, count: int, generator: torch.Generator) -> Tensor:
    """Scenes of three soft spots each, in [0, 1]."""
    centres = torch.tensor(scene.shape) * torch.rand(count, 3, 2, generator=generator)
    y = torch.exp(-((torch.arange(scene.rows) - centres[..., :1]) ** 2) / 8)
    x = torch.exp(-((torch.arange(scene.columns) - centres[..., 1:]) ** 2) / 8)
    return (y[..., :, None] * x[..., None, :]).sum(1).clamp(0, 1)


def make(camera: Camera, reach: Reach, imperfections: Imperfections) -> SceneDecoding:
    """What decodes a small scene in float64."""
    scene, embedding = Scene(14, 14), Embedding(12, 16)
    operator = TransferOperator(
        camera, scene, embedding, reach=reach, dtype=torch.float64, imperfections=imperfections
    )
    generator = torch.Generator().manual_seed(0)
    statistics = fit_statistics([blobs(scene, SCENES, generator)], 120)
    return SceneDecoding(operator, statistics, precision=Precision.DOUBLE)


def masks_of(camera: Camera) -> Iterator[Tensor]:
    """One of every kind."""
    generator = torch.Generator().manual_seed(1)
    random = torch.rand(camera.mask_shape, generator=generator, dtype=torch.float64)
    yield random
    yield torch.ones_like(random)
    hole = torch.zeros_like(random)
    hole[camera.window.rows // 2, camera.window.columns // 2] = 1
    yield hole
    random[::2] = 0
    yield random


def differences(decoding: SceneDecoding) -> dict[str, float]:
    """Largest difference of each kind, over all masks."""
    other = in_numpy(decoding)
    generator = torch.Generator().manual_seed(2)
    scenes = blobs(decoding.operator.scene, 20, generator).double()
    found = {"transfer": 0.0, "decoded scene": 0.0}
    for mask in masks_of(decoding.operator.camera):
        transfer = decoding.operator(mask)
        seen = decoding.operator.embed(scenes, mask)
        decoder, theirs = decoding.prepare(mask), other.prepare(mask.numpy())
        pairs: dict[str, tuple[Tensor, Values]] = {
            "transfer": (
                transfer / transfer.max(),
                other.operator(mask.numpy()) / float(transfer.max()),
            ),
            "decoded scene": (decoder(seen), theirs(seen.numpy())),
        }
        for name, (one, another) in pairs.items():
            found[name] = max(found[name], float(np.abs(one.numpy() - another).max()))
    return found


def largest_differences() -> dict[str, float]:
    """Over every preset, reach and place of the mask."""
    largest: dict[str, float] = {}
    for preset in PRESETS.values():
        for reach in (Reach(1, 0), Reach(3, 1)):
            for imperfections in (NOMINAL, Imperfections(rotation=1e-3, shift_x=2e-5)):
                with torch.no_grad():
                    found = differences(make(preset.camera, reach, imperfections))
                for name, value in found.items():
                    largest[name] = max(largest.get(name, 0.0), value)
    return largest


def time_ratios(rounds: int) -> dict[str, float]:
    """NumPy's time over torch's for the default job, in the daemon's precision."""
    camera, scene, embedding = Camera(), Scene(), Embedding()
    generator = torch.Generator().manual_seed(0)
    statistics = fit_statistics([blobs(scene, SCENES, generator)], 300)
    decoding = SceneDecoding(TransferOperator(camera, scene, embedding), statistics)
    other = in_numpy(decoding)
    mask = torch.rand(camera.mask_shape, generator=generator)
    with torch.inference_mode():
        medians = take_turns(
            {
                "transfer": (lambda: decoding.operator(mask), 5),
                "transfer, NumPy": (lambda: other.operator(mask.numpy()), 5),
                "decoder": (lambda: decoding.prepare(mask), 1),
                "decoder, NumPy": (lambda: other.prepare(mask.numpy()), 1),
            },
            rounds,
        )
    return {name: medians[f"{name}, NumPy"] / medians[name] for name in ("transfer", "decoder")}


def main(
    *,
    rounds: Annotated[int, typer.Option(min=1, help="Turns that everyone takes.")] = 9,
    figures: FiguresOption = None,
) -> None:
    """Print every difference and ratio; record the largest difference."""
    torch.set_num_threads(1)
    found = largest_differences()
    for name, value in found.items():
        print(f"{name:20s} {value:10.2g}")
    for name, value in time_ratios(rounds).items():
        print(f"{name + ', time':20s} {value:10.3g}")
    record(figures, {"numpy_torch_max_difference": float(f"{max(found.values()):.2g}")})


if __name__ == "__main__":
    typer.run(main)
