"""What labelled captures win back of what a badly built camera costs.

The stored mask and classifier of a bundle that comes along, on simulated cameras that are built
worse and worse: displaced, turned, at another distance, of another gamma, never quite dark, with
lines that do not obey, stray light, and another exposure. Each reads labelled digits, and the
classifier is fine-tuned to 10, 100 and 1,000 of them; other digits tell what that is worth. A
calibrated camera has gain and stray light put right, which is all that a calibration does for
stored masks. Nothing that adapts is told what is wrong.

    python -m benchmarks.training.adaptation --figures benchmarks/results/data.json
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import torch
import typer
from benchmarks.figures import FiguresOption, record
from torch import Tensor, nn

from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach
from veilcam_server.demo_data import BUNDLE, load_digits
from veilcam_training.bundle import Bundle, read_bundle
from veilcam_training.models.network import build_classifier
from veilcam_training.seeding import stream
from veilcam_training.trainer.adaptation import adapt

COUNTS = (10, 100, 1000)
SNR_DB = 40.0
LEAST_LOSS = 1.0
"""Cameras that lose less are not counted [points]."""


@dataclass(frozen=True)
class Built:
    """A camera as it was built."""

    imperfections: Imperfections
    gain: float


def draw_cameras(bundle: Bundle, count: int, seed: int) -> list[Built]:
    """Cameras built worse and worse: everything up to a share of the worst, drawn for each."""
    rows, columns = bundle.camera.mask_shape
    chance = np.random.default_rng(seed)
    cameras = []
    for _ in range(count):
        share = chance.uniform()

        def either(most: float, share: float = share) -> float:
            return float(share * most * chance.uniform(-1, 1))

        def up_to(most: float, share: float = share) -> float:
            return float(share * most * chance.uniform())

        dead_rows = chance.choice(rows, chance.binomial(2, share), replace=False)
        dead_columns = chance.choice(columns, chance.binomial(1, share), replace=False)
        cameras.append(
            Built(
                Imperfections(
                    shift_y=either(2e-4),
                    shift_x=either(2e-4),
                    rotation=either(1e-2),
                    distance_error=either(2e-4),
                    gamma=float(2 ** either(1.0)),
                    contrast_floor=up_to(0.2),
                    dead_rows=tuple(dead_rows.tolist()),
                    dead_columns=tuple(dead_columns.tolist()),
                    dead_transmittance=float(chance.uniform()),
                    stray_light=up_to(0.15),
                ),
                gain=float(1.25 ** either(1.0)),
            )
        )
    return cameras


@dataclass(frozen=True)
class Reading:
    """What one camera reads of all digits."""

    measured: Tensor
    calibrated: Tensor


def read(bundle: Bundle, built: Built, scenes: Tensor, generator: torch.Generator) -> Reading:
    """Measurements of a camera, as they come and as a calibrated daemon has them."""
    imperfections = built.imperfections
    operator = TransferOperator(
        bundle.camera,
        bundle.scene,
        bundle.embedding,
        reach=Reach(),
        imperfections=imperfections,
    )
    weights = torch.from_numpy(to_weights(bundle.pairs[0].levels, bundle.camera.panel))
    light = scenes.flatten(1) @ operator(imperfections.shown(weights))
    stray = imperfections.stray_light
    light = (1 - stray) * light + stray * light.mean(1, keepdim=True)
    measured = built.gain * shot_noise(light, SNR_DB, generator)
    straight = measured / built.gain
    straight = (straight - stray * straight.mean(1, keepdim=True)) / (1 - stray)
    return Reading(measured, straight)


def accuracy(classifier: nn.Module, values: Tensor, labels: Tensor) -> float:
    """Share of right labels [percent]."""
    return 100 * float((classifier(values).argmax(1) == labels).float().mean())


def balanced(labels: Tensor, count: int) -> Tensor:
    """Places of so many, about as many of each label, as 'veilcam collect' takes them."""
    places = [torch.nonzero(labels == label)[:, 0] for label in range(10)]
    most = max(map(len, places))
    turns = [each[turn] for turn in range(most) for each in places if turn < len(each)]
    return torch.stack(turns)[:count]


def learn(classifier: nn.Module, values: Tensor, labels: Tensor, tested: slice) -> Iterator[float]:
    """Accuracy before, and after so many captures as :data:`COUNTS` says."""
    yield accuracy(classifier, values[tested], labels[tested])
    captured = slice(tested.stop, None)
    own_values, own_labels = values[captured], labels[captured]
    for count in COUNTS:
        some = balanced(own_labels, count)
        found = adapt(classifier, own_values[some], own_labels[some])
        yield accuracy(found.classifier, values[tested], labels[tested])


def closed(simulated: float, accuracies: npt.NDArray[np.float64], column: int) -> float:
    """Share of what the cameras lose that is won back: sum of gains over sum of losses."""
    loses = simulated - accuracies[:, 0] > LEAST_LOSS
    gains = accuracies[loses, column] - accuracies[loses, 0]
    return float(gains.sum() / (simulated - accuracies[loses, 0]).sum())


def draw(path: Path, simulated: float, by_kind: dict[str, npt.NDArray[np.float64]]) -> None:
    """A line for each camera, from what it loses to what it wins back."""
    figure, panes = plt.subplots(1, 2, figsize=(9, 3.6), sharey=True, layout="constrained")
    for pane, (kind, accuracies) in zip(panes, by_kind.items(), strict=True):
        places = range(len(COUNTS) + 1)
        for line in accuracies:
            pane.plot(places, line, color="tab:blue", alpha=0.35, linewidth=1)
        pane.plot(places, accuracies.mean(0), color="tab:blue", linewidth=2.5, label="mean")
        pane.axhline(simulated, color="black", linestyle="--", linewidth=1, label="as simulated")
        pane.set_xticks(places, ["0", *(f"{count:,}" for count in COUNTS)])
        pane.set(title=kind, xlabel="labelled captures", ylim=(0, 100))
        pane.grid(alpha=0.3)
    panes[0].set_ylabel("digits read right [%]")
    panes[0].legend(loc="lower right")
    figure.savefig(path, dpi=130)
    plt.close(figure)


def main(
    figures: FiguresOption = None,
    *,
    cameras: Annotated[int, typer.Option(min=1)] = 20,
    seed: int = 1,
    picture: Annotated[
        Path | None, typer.Option(help="Draw accuracy against captures into this file.")
    ] = None,
) -> None:
    """Build cameras, adapt to each, and print what that won back."""
    torch.set_num_threads(1)
    bundle, digits = read_bundle(BUNDLE), load_digits()
    pair = bundle.pairs[0]
    classifier = build_classifier(pair.layers, pair.weights)
    scenes = torch.from_numpy(digits.images) / 255
    labels = torch.from_numpy(digits.labels.astype(np.int64))
    tested = slice(0, len(labels) - 2 * COUNTS[-1])
    generator = stream(seed, "noise")
    nominal = read(bundle, Built(NOMINAL, 1.0), scenes, generator).measured
    simulated = accuracy(classifier, nominal[tested], labels[tested])
    print(f"as simulated: {simulated:.2f} % of {tested.stop} digits")
    rows: dict[str, list[list[float]]] = {"not calibrated": [], "calibrated": []}
    for number, built in enumerate(draw_cameras(bundle, cameras, seed)):
        reading = read(bundle, built, scenes, generator)
        for kind, values in zip(rows, (reading.measured, reading.calibrated), strict=True):
            rows[kind].append(list(learn(classifier, values, labels, tested)))
            shown = "  ".join(f"{each:6.2f}" for each in rows[kind][-1])
            print(f"camera {number:2}, {kind:15}{shown}", flush=True)
    by_kind = {kind: np.array(found) for kind, found in rows.items()}
    figures_found = {"adapt_simulated": round(simulated, 2)}
    for kind, suffix in zip(by_kind, ("", "_calibrated"), strict=True):
        accuracies = by_kind[kind]
        figures_found[f"adapt_captures_0{suffix}"] = round(float(accuracies[:, 0].mean()), 2)
        for column, count in enumerate(COUNTS, 1):
            won = closed(simulated, accuracies, column)
            mean = float(accuracies[:, column].mean())
            figures_found[f"adapt_captures_{count}{suffix}"] = round(mean, 2)
            figures_found[f"adapt_gap_closed_{count}{suffix}"] = round(won, 3)
    for name, value in figures_found.items():
        print(f"{name}: {value}")
    if picture is not None:
        draw(picture, simulated, by_kind)
    record(figures, figures_found)


if __name__ == "__main__":
    typer.run(main)
