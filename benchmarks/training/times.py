"""Time to read a picture in colour, and to prepare a fresh mask, as the daemon does both.

python -m benchmarks.training.times --figures benchmarks/results/data.json
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
import typer
from benchmarks.figures import FiguresOption, record

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.decoding import MeasurementNoise, Precision, SceneFrame, SceneStatistics
from veilcam_optics.keys.masks import draw_levels
from veilcam_training.bundle import Network
from veilcam_training.bundle.layers import Linear
from veilcam_training.models.classifiers import SceneTask, Task, make_layers
from veilcam_training.models.network import build_untrained, weights_of


def milliseconds(run: Callable[[], object], times: int) -> float:
    """Median time of the processor of a call; the first one warms up."""
    run()
    seconds = []
    for _ in range(times):
        started = time.process_time()
        run()
        seconds.append(time.process_time() - started)
    return 1e3 * statistics.median(seconds)


def times_of_reading(scene: Scene, embedding: Embedding, rank: int) -> dict[str, float]:
    """Time to read one picture in colour, and to prepare a fresh mask, as the daemon does both."""
    values, inputs = 3 * scene.rows * scene.columns, 3 * embedding.size
    first = Linear(inputs=inputs, outputs=rank)
    task = Task(
        *(3, embedding.rows, embedding.columns, 10),
        rectified=True,
        normalisation="per_pixel",
        estimate=(
            SceneTask(3, scene.rows, scene.columns, 10),
            (first, Linear(inputs=rank, outputs=values)),
        ),
    )
    layers = make_layers("Scene32", task)
    network = Network.load(layers, weights_of(build_untrained(layers)))
    random = np.random.default_rng(0)
    seen = random.random((1, inputs), np.float32)
    # The time does not depend on what is known of scenes.
    known: SceneStatistics[npt.NDArray[Any]] = SceneStatistics(
        random.random(values, np.float32),
        random.standard_normal((values, rank), np.float32) / rank,
        random.random(values, np.float32) / 100,
    )
    frame = SceneFrame(Camera(), scene, embedding, known, MeasurementNoise(40.0))
    decoding = frame.decoding(precision=Precision.DOUBLE)
    levels = draw_levels(bytes(32), camera=frame.camera)
    prepared = milliseconds(lambda: decoding.prepare(frame.shown(levels)), 5)
    return {
        "head_numpy_ms": round(milliseconds(lambda: network(seen), 30), 2),
        "fresh_colour_prepare_s": round(prepared / 1e3, 3),
    }


def main(figures: FiguresOption = None) -> None:
    """Time CIFAR-10 at 27x36; print and record."""
    torch.set_num_threads(1)
    values = times_of_reading(Scene(rows=32, columns=32), Embedding(27, 36), 512)
    print(values)
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
