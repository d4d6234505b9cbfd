"""Scores of one answer as a fingerprint of the scene, behind fresh masks that nobody knows.

The attacker has the public classifier and 100 pictures of the label that was answered, the scene
among them. They put each behind masks of their own, and take the one whose scores are nearest. A
second attack tells whether two answers of one label show one scene.

    python -m benchmarks.privacy.scores --data data/mnist --figures benchmarks/results/privacy.json
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from torch import Tensor

from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import SceneDecoding, fit_statistics
from veilcam_optics.keys.masks import draw_levels
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_server.demo_data import FRESH
from veilcam_training.attacks.metrics import auc
from veilcam_training.bundle import classifier_inputs, read_bundle
from veilcam_training.data import open_source
from veilcam_training.models.network import build_classifier

GALLERY = 100
"""Pictures of one label, of which one is the scene."""
OWN = 4
"""Masks of the attacker's own behind which each picture is put."""
ANSWERS = (1, 8)
"""Answers of one scene, each behind another mask."""
SNR_DB = 40.0
STATISTICS, RANK = 6000, 256
HARDER = 5000
"""Test pictures that are attacked: MNIST's first ones are the harder, whose scores tell more."""

Told = Callable[[Tensor], Tensor]


class Reader:
    """Public classifier behind masks that are drawn anew.

    Args:
        data: folder of MNIST.
        seed: seed of the noise; masks come from the kernel.
    """

    def __init__(self, data: Path, seed: int) -> None:
        bundle = read_bundle(FRESH)
        if bundle.fresh is None:
            raise ValueError(f"{FRESH} holds no fresh masks")
        source = open_source("mnist", data)
        training, test = source.training(), source.test()
        self._bundle, self._fresh = bundle, bundle.fresh
        self._network = build_classifier(bundle.fresh.layers, bundle.fresh.weights)
        self._operator = TransferOperator(bundle.camera, bundle.scene, bundle.embedding)
        scenes = training.pixels[:STATISTICS].float() / 255
        self._decoding = SceneDecoding(self._operator, fit_statistics([scenes], RANK))
        self._noise = torch.Generator().manual_seed(seed)
        self.scenes = test.pixels[:HARDER].float().flatten(1) / 255
        self.labels = test.labels[:HARDER]

    @torch.no_grad()
    def scores(self, scenes: Tensor, masks: int, *, noisy: bool = True) -> Tensor:
        """Return float64 (masks, count, classes) of scenes (count, pixels), a mask at a time."""
        found = []
        for _ in range(masks):
            levels = draw_levels(
                os.urandom(32),
                camera=self._bundle.camera,
                distribution=self._fresh.distribution,
            )
            weights = torch.from_numpy(to_weights(levels, self._bundle.camera.panel)).float()
            measured = scenes @ self._operator(weights)
            if noisy:
                measured = shot_noise(measured, SNR_DB, self._noise)
            decoder = self._decoding.prepare(weights)
            inputs = classifier_inputs(decoder, measured)
            found.append(self._network(inputs.float()).double().softmax(1))
        return torch.stack(found)


def in_full(scores: Tensor) -> Tensor:
    """Return centred logarithms, in which rare classes count as well."""
    logarithms = scores.clamp(min=1e-12).log()
    return logarithms - logarithms.mean(-1, keepdim=True)


def in_tenths(scores: Tensor) -> Tensor:
    """Return what an answer tells of scores by default."""
    return (10 * scores).round() / 10


def identified(reader: Reader, targets: Tensor, told: Told, answers: int) -> float:
    """Return the share of scenes that are picked out of their galleries; ties share a hit."""
    hits = 0.0
    for target in targets.tolist():
        alike = torch.nonzero(reader.labels == reader.labels[target]).flatten()
        others = alike[alike != target][: GALLERY - 1]
        gallery = reader.scenes[torch.cat([torch.tensor([target]), others])]
        known = told(reader.scores(gallery, OWN, noisy=False)).mean(0)
        seen = told(reader.scores(reader.scenes[target][None], answers)).mean((0, 1))
        distances = (known - seen).square().sum(1)
        nearest = distances <= distances.min() + 1e-9
        hits += float(nearest[0]) / float(nearest.sum())
    return hits / len(targets)


def linkage(reader: Reader, targets: Tensor, told: Told, answers: int) -> float:
    """Return the AUC of whether two answers of one label show one scene."""
    scenes, labels = reader.scenes[targets], reader.labels[targets]
    first, second = (told(reader.scores(scenes, answers)).mean(0) for _ in range(2))
    distances = torch.cdist(first, second)
    alike = labels[:, None] == labels[None]
    same = torch.eye(len(targets), dtype=torch.bool)
    return auc(-distances[alike], same[alike])


def command(
    data: Annotated[Path, typer.Option(help="Folder of MNIST.")],
    *,
    scenes: Annotated[int, typer.Option(min=20, help="Scenes that are attacked.")] = 100,
    seed: int = 0,
    figures: FiguresOption = None,
) -> None:
    """Attack scores in full and in tenths, of one answer and of eight."""
    torch.set_num_threads(1)
    reader = Reader(data, seed)
    random = torch.Generator().manual_seed(seed)
    targets = torch.randperm(len(reader.labels), generator=random)[:scenes]
    for name, told in (("scores_full", in_full), ("scores", in_tenths)):
        for answers in ANSWERS:
            picked = 100 * identified(reader, targets, told, answers)
            linked = linkage(reader, targets, told, answers)
            after = "" if answers == 1 else f"_{answers}_answers"
            found = {
                f"{name}_identified_of_100{after}": round(picked, 2),
                f"{name}_linkage_auc{after}": round(linked, 4),
            }
            print(f"{found}; chance 1 and .5", flush=True)
            record(figures, found)


if __name__ == "__main__":
    typer.run(command)
