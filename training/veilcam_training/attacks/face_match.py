"""Face matching: a small network tells whether two pictures show the same person.

It is a score of this project: fitted to whatever faces it is given, drawn ones say, by a softmax
over the cosines to one direction for each person (NormFace, Wang et al. 2017). It is no measure
of anybody else's, and its numbers do not stand beside those of networks for photographs.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, normalize

from veilcam_training.attacks.networks import Progress
from veilcam_training.errors import require
from veilcam_training.seeding import seeded

FEATURES = 64
SHARPNESS = 16.0
"""Of the softmax over cosines."""
NOISE = 0.1
"""Of pictures while it learns: what is matched has been decoded, and is not clean."""
_BATCH = 128


@dataclass(frozen=True)
class FaceMatch:
    """A fitted network."""

    network: nn.Module

    def features(self, pictures: Tensor) -> Tensor:
        """Directions, (count, :data:`FEATURES`), of pictures (count, rows, columns) in [0, 1]."""
        with torch.no_grad():
            parts = [self.network(each[:, None]) for each in pictures.clamp(0, 1).split(512)]  # type: ignore[no-untyped-call]
            return normalize(torch.cat(parts))

    def __call__(self, one: Tensor, other: Tensor) -> Tensor:
        """Score of every pair, (count,): 1 for the same picture, about 0 for two strangers."""
        return (self.features(one) * self.features(other)).sum(1)


def fit_face_match(
    pictures: Tensor,
    identities: Tensor,
    *,
    epochs: int,
    seed: int,
    progress: Progress | None = None,
) -> FaceMatch:
    """Fit a network to tell persons apart.

    Args:
        pictures: (count, rows, columns) in [0, 1], 8 x 8 or more.
        identities: int64 (count,), any numbers.
        epochs: number of times that each picture is seen.
        seed: seed of weights, order and noise.
        progress: is told of epochs.

    Raises:
        TrainingError: fewer than two persons, or pictures that are too small.
    """
    rows, columns = pictures.shape[1:]
    require(min(rows, columns) >= 8, f"faces of {rows} x {columns} are too small: use 8 x 8")
    known, labels = torch.unique(identities, return_inverse=True)
    require(len(known) > 1, "one person alone is told from nobody: give two or more")
    with seeded(seed, "face match"):
        network = nn.Sequential(
            *(nn.Conv2d(1, 16, 3, padding=1), nn.BatchNorm2d(16), nn.ReLU(), nn.MaxPool2d(2)),
            *(nn.Conv2d(16, 32, 3, padding=1), nn.BatchNorm2d(32), nn.ReLU(), nn.MaxPool2d(2)),
            *(nn.Conv2d(32, 64, 3, padding=1), nn.BatchNorm2d(64), nn.ReLU()),
            *(nn.Flatten(), nn.Linear(64 * (rows // 4) * (columns // 4), FEATURES)),
        )
        persons = nn.Parameter(torch.randn(len(known), FEATURES))
        optimiser = torch.optim.AdamW([*network.parameters(), persons], 2e-3, weight_decay=1e-2)
        for epoch in range(epochs):
            for part in torch.split(torch.randperm(len(labels)), _BATCH):
                if len(part) < 2:  # batch statistics need two
                    continue
                clean = pictures[part, None]
                features = normalize(network(clean + NOISE * torch.randn_like(clean)))
                cosines = features @ normalize(persons).T
                optimiser.zero_grad()
                loss = cross_entropy(SHARPNESS * cosines, labels[part])
                loss.backward()  # type: ignore[no-untyped-call]
                optimiser.step()
            if progress is not None:
                progress(epoch + 1, epochs)
    return FaceMatch(network.eval())
