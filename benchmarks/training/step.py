"""How long one training step takes with a learned mask, compared with a fixed one.

The model is FC-800 behind a 24 x 32 embedding of 28 x 28 scenes, the step the one that fitting
runs: gather, encode, noise, classify, backward, Adam, projection. A fixed mask is timed twice:
with its measurements computed once for all epochs, which is what fitting does, and with the scenes
encoded in every step, which is what any changing scene needs.

    python -m benchmarks.training.step --figures benchmarks/results/main-job.json
"""

from __future__ import annotations

import statistics
import time
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record

from veilcam_training.config.settings import FitSettings
from veilcam_training.data import Images
from veilcam_training.encoders import Setup, make_encoder
from veilcam_training.models.classifiers import Task, make_layers
from veilcam_training.models.lensless import LenslessClassifier
from veilcam_training.seeding import seeded, stream
from veilcam_training.trainer.step import Inputs, make_optimiser, train_step

CASES = {"learned": "learned", "fixed": "fixed_simulated", "fixed, encoded each step": "encoded"}


class Case:
    """One model and its data, ready to step."""

    def __init__(self, encoder: str, images: Images) -> None:
        name = "fixed_simulated" if encoder == "encoded" else encoder
        camera = make_encoder(name, Setup(), stream(0, "encoder"))
        layers = make_layers(
            "FC800", Task(1, 24, 32, 10, rectified=True, normalisation="per_pixel")
        )
        with seeded(0, "classifier"):
            self.model = LenslessClassifier(camera, layers, 40.0)
        self.optimiser = make_optimiser(self.model, FitSettings())
        if encoder == "encoded":
            camera.constant = False  # so that nothing is computed ahead
        self.inputs = Inputs(self.model, images, FitSettings())

    def seconds(self, chosen: torch.Tensor) -> float:
        """Duration of one step [s]."""
        start = time.perf_counter()
        train_step(self.model, self.inputs, chosen, self.optimiser)
        return time.perf_counter() - start


def main(
    *,
    steps: Annotated[int, typer.Option(min=3, help="Timed steps of each kind.")] = 60,
    threads: Annotated[int, typer.Option(min=1)] = 1,
    figures: FiguresOption = None,
) -> None:
    """Print the median step of each kind; record the ratio of learned to fixed at batch 512."""
    torch.set_num_threads(threads)
    generator = stream(0, "images")
    images = Images(
        torch.randint(0, 256, (4096, 28, 28), generator=generator, dtype=torch.uint8),
        torch.randint(0, 10, (4096,), generator=generator),
    )
    medians: dict[tuple[str, int], float] = {}
    for batch in (64, 512):
        cases = {name: Case(encoder, images) for name, encoder in CASES.items()}
        times: dict[str, list[float]] = {name: [] for name in cases}
        # The kinds take turns, so that whatever else the machine does meets all of them alike.
        for step in range(steps + 5):
            chosen = torch.randperm(len(images), generator=generator)[:batch]
            for name, case in cases.items():
                seconds = case.seconds(chosen)
                if step >= 5:
                    times[name].append(seconds)
        for name, values in times.items():
            medians[name, batch] = statistics.median(values)
            print(f"batch {batch:4d}  {name:26s} {1e3 * medians[name, batch]:7.2f} ms")
        for name in ("fixed", "fixed, encoded each step"):
            ratio = medians["learned", batch] / medians[name, batch]
            print(f"batch {batch:4d}  learned / {name}: {ratio:.2f}")
    ratios = [medians["learned", batch] / medians["fixed", batch] for batch in (64, 512)]
    record(figures, {"step_ratio_learned_over_fixed": round(max(ratios), 3)})


if __name__ == "__main__":
    typer.run(main)
