"""Stored masks whose pairs an attacker holds: learned for a task, or drawn at random."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, cross_entropy

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.masks import random_mask, to_levels, to_weights
from veilcam_optics.files import replacing
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.data import Images
from veilcam_training.encoders import LearnedMask, Setup
from veilcam_training.seeding import stream

SNR_DB = 40.0
STEPS, BATCH = 60, 200
RATE = 1e-2
POOLING = 2
"""Masks are learned on pictures of so much larger pixels: a quarter of the time."""


@dataclass(frozen=True)
class Kind:
    """Which masks, and how many."""

    name: str
    masks: int
    learned: bool


KINDS = (
    Kind("1", 1, learned=True),
    Kind("10", 10, learned=True),
    Kind("100", 100, learned=True),
    Kind("10random", 10, learned=False),
)


def learn_mask(camera: Camera, scene: Scene, scenes: Tensor, labels: Tensor, seed: int) -> Tensor:
    """A mask fitted together with a linear classifier, weights as the panel shows them.

    Args:
        camera: of the mask.
        scene: before it.
        scenes: pictures (count, rows, columns), both sides of which ``POOLING`` divides.
        labels: int64 (count,).
        seed: of the mask that it starts from, of the batches and of the noise.
    """
    small = replace(scene, rows=scene.rows // POOLING, columns=scene.columns // POOLING)
    encoder = LearnedMask(Setup(camera, small, Embedding()), stream(seed, "mask"))
    random = stream(seed, "batches")
    numbers = encoder.setup.outputs
    head = nn.Linear(numbers, int(labels.max()) + 1)
    # From nothing: no weight is drawn that the seed does not settle.
    nn.init.zeros_(head.weight)
    nn.init.zeros_(head.bias)
    normalise = nn.BatchNorm1d(numbers, affine=False)
    optimiser = torch.optim.Adam([*encoder.parameters(), *head.parameters()], RATE)
    for _ in range(STEPS):
        chosen = torch.randint(len(scenes), (BATCH,), generator=random)
        pooled = avg_pool2d(scenes[chosen][:, None], POOLING)[:, 0]
        values = shot_noise(encoder(pooled), SNR_DB, random)
        loss = cross_entropy(head(normalise(values / values.detach().mean())), labels[chosen])
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        encoder.project()
    return torch.from_numpy(to_weights(encoder.levels(), camera.panel))


def stored_mask(
    folder: Path, kind: Kind, place: int, *, camera: Camera, scene: Scene, images: Images
) -> Tensor:
    """Mask ``place``: the same for every number of learned masks, and learned once."""
    if not kind.learned:
        drawn = random_mask(camera, stream(place, "random mask"))
        return torch.from_numpy(to_weights(to_levels(drawn, camera.panel), camera.panel))
    path = folder / f"mask-{place:03}.npy"
    if not path.exists():
        scenes = images.scenes()
        scenes = scenes.mean(1) if scenes.ndim == 4 else scenes
        weights = learn_mask(camera, scene, scenes, images.labels, place)
        with replacing(path) as file:
            np.save(file, to_levels(weights, camera.panel))
    return torch.from_numpy(to_weights(np.load(path), camera.panel))


def embedded(
    operator: TransferOperator, masks: list[Tensor], scenes: Tensor, generator: torch.Generator
) -> Tensor:
    """Raw embeddings (count, numbers), each behind any of the masks; which one is not told."""
    behind = torch.randint(len(masks), (len(scenes),), generator=generator)
    values = scenes.new_empty(len(scenes), operator.embedding.size)
    for place, weights in enumerate(masks):
        chosen = behind == place
        if bool(chosen.any()):
            light = scenes[chosen].flatten(1) @ operator(weights)
            values[chosen] = shot_noise(light, SNR_DB, generator)
    return values
