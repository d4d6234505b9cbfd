"""How exactly light must be simulated for a mask and its classifier: accuracy against time.

A mask and a classifier are fitted to light that is simulated with fewer and fewer effects, and
tested in light that is simulated with all of them. The same fit with all effects in its last
quarter alone tells whether the time of a fine simulation can be saved for the end.

    python -m benchmarks.training.tolerance --data data/mnist --picture docs/images/tolerance.png
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.paper.style import tidy
from matplotlib.axes import Axes
from rich.progress import track
from torch import Tensor
from torch.nn.functional import cross_entropy

from veilcam_optics import effects
from veilcam_optics.camera.geometry import Embedding
from veilcam_optics.effects.model import Model, Sampling
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.regions import Region
from veilcam_optics.transfer.tables import Reach
from veilcam_training.config.settings import FitSettings, parse_embedding
from veilcam_training.data import Images, open_source
from veilcam_training.encoders import LearnedMask, Setup
from veilcam_training.experiments.card_page import panels_of
from veilcam_training.models.classifiers import Task, make_layers
from veilcam_training.models.lensless import LenslessClassifier
from veilcam_training.seeding import seeded, stream
from veilcam_training.trainer.step import Inputs, evaluate, make_optimiser, train_step

INTERVAL = 4.303 / 3**0.5
"""Half of a 95 % interval of the mean of three, in standard deviations (Student's t, 2 degrees)."""
SEEDS = 3
NEAREST = Reach(0, 0)
COARSE_FIRST = "all but interference, all at the end"


@dataclass(frozen=True)
class Dial:
    """How light is simulated in a fit.

    Attributes:
        without: names of the effects that are left out.
        reach: which sub-pixels interfere.
        zones: parts of the field along each side, each with a point spread function of its own.
    """

    without: tuple[str, ...] = ()
    reach: Reach = NEAREST
    zones: int = 1

    def model(self, setup: Setup) -> Model:
        """The model of the light that the dial stands for."""
        sampling = Sampling(reach=self.reach, zones=self.zones)
        model = Model(setup.camera, setup.scene, setup.embedding, sampling=sampling)
        for effect in effects.EFFECTS:
            if effect.name in self.without:
                model = effect.without(model)
        return model


FINEST = Dial(reach=Reach(6, 1), zones=7)
DIALS: dict[str, Dial] = {
    "shadows of whole cells, gray": Dial(("diffraction", "dead space", "colour filters")),
    "shadows without dead space": Dial(("diffraction", "dead space")),
    "shadows": Dial(("diffraction",)),
    "all but interference": Dial(),
    "nearest interference": Dial(reach=Reach(3, 1)),
    "all": FINEST,
}


class SimulatedMask(LearnedMask):
    """A mask, learned or not, behind light that is simulated as one asks.

    Args:
        setup: camera, scene and measurement.
        generator: draws the mask.
        light: from mask weights to the transfer matrix.
        learned: False keeps the mask as it was drawn.
    """

    def __init__(
        self, setup: Setup, generator: torch.Generator, light: LightOperator, *, learned: bool
    ) -> None:
        super().__init__(setup, generator)
        self.weights.requires_grad_(learned)
        self.shine(light)

    def shine(self, light: LightOperator) -> None:
        """Simulate the light so from now on."""
        # In a list: kernels are constants of the camera and belong in no state_dict.
        self._light = [light]
        self._matrix: Tensor | None = None

    def _transfer(self, shown: Tensor, part: Region | None, grid: int) -> Tensor:
        if self.weights.requires_grad:
            return self._of_part(self._light[0](shown), part, grid)
        if self._matrix is None:  # a fixed mask's matrix is made once
            self._matrix = self._light[0](shown)
        return self._of_part(self._matrix, part, grid)


@dataclass(frozen=True)
class Outcome:
    """Of one fit.

    Attributes:
        accuracy: on the test set, in the finest light.
        seconds: of the fit.
    """

    accuracy: float
    seconds: float


def fitted(
    lights: Sequence[tuple[float, LightOperator]],
    setup: Setup,
    images: Images,
    test: Images,
    *,
    finest: LightOperator,
    learned: bool,
    epochs: int,
    seed: int,
) -> Outcome:
    """Fit, then look at the test set once.

    Args:
        lights: how light is simulated, each from this share of the fit on; the first from 0.
        setup: camera, scene and measurement.
        images: to fit to.
        test: to test with.
        finest: what the test is simulated with.
        learned: whether the mask is.
        epochs: of the fit.
        seed: of mask, classifier, order and noise.
    """
    camera = SimulatedMask(setup, stream(seed, "encoder"), lights[0][1], learned=learned)
    task = Task(1, setup.embedding.rows, setup.embedding.columns, 10, True, "per_pixel")
    layers = make_layers("FC800", task)
    with seeded(seed, "classifier"):
        model = LenslessClassifier(camera, layers, 40.0)
    settings = FitSettings(batch=128)
    optimiser = make_optimiser(model, settings)
    inputs, order = Inputs(model, images, settings), stream(seed, "order")
    parts = -(-len(images) // settings.batch)
    batches = [
        chosen
        for _ in range(epochs)
        for chosen in torch.randperm(len(images), generator=order).tensor_split(parts)
    ]
    started, shining = time.process_time(), lights[0][1]
    for step, chosen in enumerate(batches):
        progress = step / len(batches)
        light = [light for begins, light in lights if begins <= progress][-1]
        if light is not shining:
            camera.shine(light)
            shining = light
        for group in optimiser.param_groups:
            group["lr"] = group["peak"] * settings.rate_factor(progress)
        train_step(model, inputs, chosen, optimiser)
    seconds = time.process_time() - started
    camera.shine(finest)
    return Outcome(100 * evaluate(model, test, seed, "test").accuracy, seconds)


def transfer_errors(setup: Setup, finest: LightOperator, dial: Dial) -> tuple[float, float]:
    """Relative L2 error of a random mask's transfer, and of a loss's gradient by the mask.

    The loss is that of a random linear classifier of random scenes: a mask is learned by it.
    """
    generator = stream(0, "errors")
    mask = LearnedMask(setup, generator)
    scenes = torch.rand(64, setup.scene.rows * setup.scene.columns, generator=generator)
    labels = torch.randint(10, (64,), generator=generator)
    matrix = torch.randn(setup.embedding.size, 10, generator=generator)
    found = []
    for light in (LightOperator(dial.model(setup)), finest):
        weights = mask.weights.detach().clone().requires_grad_()
        transfer = light(weights)
        seen = scenes @ transfer
        seen = seen / seen.detach().square().mean().sqrt()
        cross_entropy(seen @ matrix, labels).backward()  # type: ignore[no-untyped-call]
        gradient = weights.grad
        assert gradient is not None
        found.append((transfer.detach(), gradient))
    (transfer, gradient), (truth, true_gradient) = found
    return (
        float((transfer - truth).norm() / truth.norm()),
        float((gradient - true_gradient).norm() / true_gradient.norm()),
    )


def shown(percent: float) -> str:
    """Two digits, and no exponent."""
    return f"{percent:.0f}" if percent >= 10 else f"{percent:.2g}"


def draw_chart(axes: Axes, results: dict[str, list[Outcome]], errors: dict[str, float]) -> None:
    """Accuracy against the time of a fit, one mark for each way of simulating light."""
    for number, (name, outcomes) in enumerate(results.items()):
        accuracy = [outcome.accuracy for outcome in outcomes]
        error = INTERVAL * statistics.stdev(accuracy) if len(accuracy) > 1 else 0.0
        off = "" if name not in errors else f" ({shown(100 * errors[name])} % off)"
        axes.errorbar(
            statistics.mean(outcome.seconds for outcome in outcomes),
            statistics.mean(accuracy),
            yerr=error,
            fmt="osD^vPX"[number],
            capsize=3,
            color=f"C{number}",
            label=name + off,
        )
    axes.set_xlabel("time of a fit, one core [s]")
    axes.set_ylabel("test accuracy in the finest light [%]")
    tidy(axes)


def main(
    *,
    data: Annotated[Path, typer.Option(help="Folder of MNIST's files.")],
    embedding: Annotated[str, typer.Option(help="ROWSxCOLUMNS of the embedding.")] = "6x8",
    images: Annotated[int, typer.Option(min=128, help="Training images.")] = 20_000,
    epochs: Annotated[int, typer.Option(min=1)] = 4,
    picture: Annotated[Path | None, typer.Option(help="PNG to write.")] = None,
    figures: FiguresOption = None,
) -> None:
    """Print a table; draw it and record figures where asked for."""
    torch.set_num_threads(1)
    source = open_source("mnist", data)
    training, test = source.training(), source.test()
    training = training.take(torch.arange(min(images, len(training))))
    shape: Embedding = parse_embedding(embedding)
    setup = Setup(embedding=shape)
    finest = LightOperator(FINEST.model(setup))
    lights = {name: LightOperator(dial.model(setup)) for name, dial in DIALS.items()}
    ways = {name: [(0.0, light)] for name, light in lights.items()}
    ways[COARSE_FIRST] = [(0.0, lights["all but interference"]), (0.75, lights["all"])]
    errors = {name: transfer_errors(setup, finest, dial) for name, dial in DIALS.items()}
    results: dict[bool, dict[str, list[Outcome]]] = {True: {}, False: {}}
    jobs = [(seed, learned, name) for seed in range(SEEDS) for learned in results for name in ways]
    for seed, learned, name in track(jobs, "fits"):
        outcome = fitted(
            ways[name],
            setup,
            training,
            test,
            finest=finest,
            learned=learned,
            epochs=epochs,
            seed=seed,
        )
        results[learned].setdefault(name, []).append(outcome)
    values: dict[str, float] = {}
    for learned, found in results.items():
        kind = "learned" if learned else "fixed"
        for name, outcomes in found.items():
            accuracy = [outcome.accuracy for outcome in outcomes]
            mean, error = statistics.mean(accuracy), INTERVAL * statistics.stdev(accuracy)
            seconds = statistics.mean(outcome.seconds for outcome in outcomes)
            transfer, gradient = errors.get(name, (0.0, 0.0))
            print(
                f"{kind:8}{name:38}{mean:7.2f} +-{error:5.2f} %{seconds:8.1f} s"
                f"   transfer {transfer:.1e}   gradient {gradient:.1e}"
            )
            key = f"tolerance_{kind}_{'_'.join(name.replace(',', '').split())}"
            values[key] = round(mean, 2)
            values[f"{key}_interval"] = round(error, 2)
    if picture is not None:
        figure, [panels] = panels_of(1, 2, (5.2, 4.2))
        for axes, (learned, found) in zip(panels, results.items(), strict=True):
            draw_chart(axes, found, {name: transfer for name, (transfer, _) in errors.items()})
            axes.set_title(f"{'learned' if learned else 'fixed'} mask, {embedding}")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        figure.savefig(picture, dpi=150)
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
