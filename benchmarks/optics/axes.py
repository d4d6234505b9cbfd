"""What an accuracy chart leaves out: many masks at once, memory, and the time of a plan.

With one thread, counts taking turns, the processor's time throughout:

- masks at once: time of each, and the most memory that they need beside the tables, matrices
  included; NumPy's, which tells its allocations, of the same products as torch's;
- ``transfer_tables_mb`` and ``transfer_peak_mb``: tables of the default job, and that memory for
  one mask; ``transfer_peak_mb_64`` for 64;
- ``plan_cpu_ms_1e-1`` to ``plan_cpu_ms_1e-4``: the first plan of the default job in a fresh process
  that has imported what it needs, by its tolerance.

    python -m benchmarks.optics.axes --picture docs/images/axes.png \
        --figures benchmarks/results/optics.json
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy.typing as npt
import torch
import typer
from benchmarks.figures import FiguresOption, record
from matplotlib.figure import Figure

from veilcam_optics.arrays import as_numpy
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.plan import plan
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.product import Transfer

EMBEDDINGS = ((3, 4), (6, 8), (12, 16), (24, 32))
COUNTS = (1, 2, 4, 8, 16, 32, 64)
TOLERANCES = ("1e-1", "1e-2", "1e-3", "1e-4")
Values = npt.NDArray[Any]

_COLOURS = ("#0b7a5b", "#1f6fb5", "#6a4fb3", "#d1495b")


@dataclass(frozen=True)
class Batches:
    """One embedding's transfers, by how many masks there are at once."""

    embedding: Embedding
    tables: int
    """Bytes."""
    seconds: Sequence[float]
    """Of each mask."""
    peak: Sequence[int]
    """Bytes beside the tables, of all masks."""


def measure_batches(embedding: Embedding, rounds: int) -> Batches:
    """Time and memory of transfers of the default camera and scene."""
    camera = Camera()
    operator = TransferOperator(camera, Scene(), embedding)
    masks = torch.rand(max(COUNTS), *camera.mask_shape, generator=torch.Generator().manual_seed(0))
    times: dict[int, list[float]] = {count: [] for count in COUNTS}
    with torch.no_grad():
        for _ in range(rounds + 1):
            for count in COUNTS:
                start = time.process_time()
                for _ in range(max(COUNTS) // count):
                    operator(masks[:count])
                times[count].append((time.process_time() - start) / max(COUNTS))
    arrays = {name: as_numpy(table) for name, table in operator.transfer.arrays().items()}
    transfer = Transfer.from_arrays(camera, operator.scene, embedding, arrays)
    return Batches(
        embedding,
        sum(table.nbytes for table in arrays.values()),
        [statistics.median(found[1:]) for found in times.values()],
        [peak_memory(transfer, masks[:count].numpy()) for count in COUNTS],
    )


def peak_memory(transfer: Transfer[Values], masks: Values) -> int:
    """Most bytes that NumPy holds at once for the transfers of masks, themselves included."""
    tracemalloc.start()
    try:
        transfer(masks)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def plan_cpu_ms(tolerance: str, rounds: int) -> float:
    """Median over fresh processes [ms]."""
    command = [sys.executable, "-m", "benchmarks.optics.axes", "--only-plan", tolerance]
    return statistics.median(
        float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        for _ in range(rounds)
    )


def time_one_plan(tolerance: float) -> None:
    """Print the processor's time [ms] for the first plan of this process."""
    start = time.process_time()
    plan(Camera(), Scene(), Embedding(), tolerance)
    print(1e3 * (time.process_time() - start))


def draw(path: Path, batches: Sequence[Batches], planning: Sequence[float]) -> None:
    """Write the picture: time of a mask, memory, and planning time [ms] by tolerance."""
    figure = Figure(figsize=(15, 4.6), layout="constrained")
    times, memory, plans = figure.subplots(1, 3)
    for found, colour in zip(batches, _COLOURS, strict=True):
        rows, columns = found.embedding.shape
        label = f"{rows} x {columns}, tables {found.tables / 1e6:.2g} MB"
        times.plot(COUNTS, [1e3 * s for s in found.seconds], "o-", color=colour, label=label)
        memory.plot(COUNTS, [peak / 1e6 for peak in found.peak], "o-", color=colour, label=label)
    times.set(xscale="log", yscale="log", title="Time of a mask's transfer", ylabel="ms, each mask")
    memory.set(xscale="log", yscale="log", title="Memory beside the tables", ylabel="MB, all masks")
    for axes in (times, memory):
        axes.set_xlabel("masks at once")
        axes.set_xticks(COUNTS, [str(count) for count in COUNTS])
        axes.minorticks_off()
        axes.legend(frameon=False, fontsize=8)
    bars = plans.bar(range(len(TOLERANCES)), planning, color=_COLOURS[1], width=0.6)
    plans.bar_label(bars, fmt="%.0f")
    plans.set_xticks(range(len(TOLERANCES)), TOLERANCES)
    plans.set(title="First plan of a process, 24 x 32", xlabel="tolerance", ylabel="ms")
    for axes in (times, memory, plans):
        axes.grid(which="major", axis="y", color="#dddddd", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110, facecolor="white")


def main(
    *,
    rounds: Annotated[int, typer.Option(min=1, help="Turns that every count takes.")] = 5,
    picture: Annotated[Path | None, typer.Option(help="Picture to write.")] = None,
    figures: FiguresOption = None,
    only_plan: Annotated[float, typer.Option("--only-plan", hidden=True)] = 0.0,
) -> None:
    """Measure all three; draw them; record them."""
    torch.set_num_threads(1)
    if only_plan:
        time_one_plan(only_plan)
        return
    planning = [plan_cpu_ms(tolerance, 3) for tolerance in TOLERANCES]
    batches = [measure_batches(Embedding(*shape), rounds) for shape in EMBEDDINGS]
    for found in batches:
        print(f"{found.embedding.shape}: tables {found.tables / 1e6:.3g} MB")
        for count, seconds, peak in zip(COUNTS, found.seconds, found.peak, strict=True):
            print(f"{count:6d} masks at once {1e3 * seconds:8.3f} ms each {peak / 1e6:8.2f} MB")
    largest = batches[-1]
    values = {
        "transfer_tables_mb": largest.tables / 1e6,
        "transfer_peak_mb": largest.peak[0] / 1e6,
        f"transfer_peak_mb_{COUNTS[-1]}": largest.peak[-1] / 1e6,
        **{f"plan_cpu_ms_{t}": ms for t, ms in zip(TOLERANCES, planning, strict=True)},
    }
    for name, value in values.items():
        print(f"{name:24s} {value:10.3g}")
    if picture is not None:
        draw(picture, batches, planning)
    record(figures, {name: float(f"{value:.3g}") for name, value in values.items()})


if __name__ == "__main__":
    typer.run(main)
