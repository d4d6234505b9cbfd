"""How near the transfer operator and the planner are to what they cannot do without.

With one thread, contestants taking turns:

- ``transfer_over_matmul``: time of the default job's transfer matrix, from a mask to the matrix in
  the order of its pixels, over that of the largest of its products of matrices alone;
- ``mask_batch_speedup``: time of 64 masks one by one over that of the 64 at once, for an embedding
  of 3 x 4; ``mask_batch_speedup_6x8`` and so on for larger ones, of which there is less to gain: at
  24 x 32 a matrix is 2.4 MB, and its own arithmetic and memory take the time;
- ``plan_cpu_ms``: time of the processor for the first plan of the default job, at a tolerance of
  1e-2, in a fresh process that has imported what it needs.

    python -m benchmarks.optics.limit --figures benchmarks/results/optics.json
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.optics.step import take_turns

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.plan import plan
from veilcam_optics.transfer.operator import TransferOperator

MASKS = 64
TOLERANCE = 1e-2


def transfer_over_matmul(rounds: int) -> float:
    """Time of a whole transfer over that of the product that gathers the pairs along y."""
    camera, scene, embedding = Camera(), Scene(), Embedding()
    operator = TransferOperator(camera, scene, embedding)
    weights = torch.rand(camera.mask_shape, generator=torch.Generator().manual_seed(0))
    # Without leakage or interference of neighbours each row is one pair, of its own colour.
    down = torch.rand(scene.rows * embedding.rows, camera.window.rows)
    across = torch.rand(camera.window.rows, scene.columns * embedding.columns)
    with torch.no_grad():
        medians = take_turns(
            {
                "transfer": (lambda: operator(weights), 20),
                "product": (lambda: down @ across, 20),
            },
            rounds,
        )
    return medians["transfer"] / medians["product"]


def mask_batch_speedup(embedding: Embedding, rounds: int) -> float:
    """Time of masks one by one, their matrices kept, over that of all at once."""
    camera = Camera()
    operator = TransferOperator(camera, Scene(), embedding)
    masks = torch.rand(MASKS, *camera.mask_shape, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        medians = take_turns(
            {
                "one by one": (lambda: [operator(mask) for mask in masks], 1),
                "together": (lambda: operator(masks), 1),
            },
            rounds,
        )
    return medians["one by one"] / medians["together"]


def time_one_plan() -> None:
    """Print the processor's time [ms] for the first plan of this process."""
    start = time.process_time()
    plan(Camera(), Scene(), Embedding(), TOLERANCE)
    print(1e3 * (time.process_time() - start))


def plan_cpu_ms(rounds: int) -> float:
    """Median over fresh processes [ms]."""
    command = [sys.executable, "-m", "benchmarks.optics.limit", "--only-plan"]
    return statistics.median(
        float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        for _ in range(rounds)
    )


def main(
    *,
    rounds: Annotated[int, typer.Option(min=1, help="Turns that everyone takes.")] = 9,
    figures: FiguresOption = None,
    only_plan: Annotated[bool, typer.Option("--only-plan", hidden=True)] = False,
) -> None:
    """Print every figure; record them."""
    torch.set_num_threads(1)
    if only_plan:
        time_one_plan()
        return
    values = {
        "transfer_over_matmul": transfer_over_matmul(rounds),
        "mask_batch_speedup": mask_batch_speedup(Embedding(3, 4), rounds),
        **{
            f"mask_batch_speedup_{rows}x{columns}": mask_batch_speedup(
                Embedding(rows, columns), rounds
            )
            for rows, columns in ((6, 8), (12, 16), (24, 32))
        },
        "plan_cpu_ms": plan_cpu_ms(rounds),
    }
    for name, value in values.items():
        print(f"{name:26s} {value:10.3g}")
    record(figures, {name: float(f"{value:.4g}") for name, value in values.items()})


if __name__ == "__main__":
    typer.run(main)
