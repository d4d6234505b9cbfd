"""Scores that might refuse what is no digit: what they refuse where they refuse few digits.

``python -m benchmarks.people.unknown``

Two are tried: the energy of a look's logits, -log sum exp z (Liu et al. 2020), and the Mahalanobis
distance of what the classifier's last layer is given, to the nearest class (Lee et al. 2018). Means
and covariance come from digits that fixed the filter, thresholds from others of these, and what is
refused is counted with digits and scenes that fixed nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer
from benchmarks.people.belief import TESTING
from benchmarks.people.looks import (
    Rig,
    Scenes,
    as_scenes,
    fixing_digits,
    odd_scenes,
    unseen_digits,
)
from PIL import Image, ImageDraw

from veilcam_server.watch.belief import Thresholds
from veilcam_training.bundle import Network, classifier_inputs

Values = npt.NDArray[np.float64]

REFUSED = (0.002, 0.005, 0.01)
"""Shares of digits that thresholds refuse, of those that set them."""
SHRINKAGE = 1e-3
"""Of the covariance towards its mean variance, which keeps it invertible."""


class Reader:
    """Looks at scenes, each behind one of a few masks, as far as the classifier's last layer.

    Args:
        seed: of masks and noise.
        masks: how many.
    """

    def __init__(self, seed: int, masks: int = 24) -> None:
        self._rig = Rig(seed, masks)
        fresh = self._rig.bundle.fresh
        assert fresh is not None
        self._last = str(len(fresh.layers) - 1)
        inner = {
            name: value
            for name, value in fresh.weights.items()
            if not name.startswith(f"{self._last}.")
        }
        self._network = Network.load(fresh.layers[:-1], inner)
        self._weights = fresh.weights

    def features(self, scenes: Scenes) -> Values:
        """What the last layer is given of the looks that are admitted, (looks, features)."""
        found = list[Values]()
        for mask, some in zip(
            self._rig.masks, np.array_split(scenes, len(self._rig.masks)), strict=True
        ):
            read = self._rig.measured(some, mask)
            told = mask.reader.evidence_of(read)
            admitted = [Thresholds().admits(each) for each in told]
            inputs = classifier_inputs(mask.reader.decoder, read[admitted]).astype(np.float32)
            found.append(self._network(inputs).astype(np.float64))
        return np.concatenate(found)

    def energy(self, features: Values) -> Values:
        """Greater where no class is likely, (looks,)."""
        weight, bias = (self._weights[f"{self._last}.{name}"] for name in ("weight", "bias"))
        logits = features @ weight.T + bias
        energies: Values = -np.log(np.exp(logits).sum(axis=1))
        return energies


def distance(features: Values, labels: npt.NDArray[np.uint8]) -> Callable[[Values], Values]:
    """What gives the squared Mahalanobis distance to the nearest of the classes of these looks."""
    means = np.array([features[labels == label].mean(axis=0) for label in np.unique(labels)])
    spread = np.cov((features - means[labels]).T)
    spread += SHRINKAGE * np.trace(spread) / len(spread) * np.eye(len(spread))
    inverse = np.linalg.inv(spread)

    def nearest(others: Values) -> Values:
        apart = others[:, None] - means
        squares: Values = np.einsum("nki,ij,nkj->nk", apart, inverse, apart).min(axis=1)
        return squares

    return nearest


def shapes(count: int, draw: np.random.Generator) -> Scenes:
    """Frames, crosses, triangles and discs of a digit's size, of white on black."""
    made = list[npt.NDArray[np.uint8]]()
    for number in range(count):
        picture = Image.new("L", (28, 28))
        pen = ImageDraw.Draw(picture)
        left, top = (int(each) for each in draw.integers(4, 8, 2))
        right, bottom = left + int(draw.integers(13, 18)), top + int(draw.integers(13, 18))
        match number % 4:
            case 0:
                pen.rectangle((left, top, right, bottom), outline=255, width=3)
            case 1:
                pen.line((left, top, right, bottom), fill=255, width=3)
                pen.line((left, bottom, right, top), fill=255, width=3)
            case 2:
                middle = (left + right) // 2
                pen.polygon(((left, bottom), (middle, top), (right, bottom)), outline=255, width=3)
            case _:
                pen.ellipse((left, top, right, bottom), fill=255)
        made.append(np.asarray(picture))
    return as_scenes(np.array(made))


def main(
    *,
    count: Annotated[int, typer.Option(help="Scenes of each kind.")] = 200,
    seed: int = TESTING,
) -> None:
    """Print the share of admitted looks that each score refuses, by scene and threshold."""
    reader, draw = Reader(seed), np.random.default_rng(seed)
    fixing, unseen = fixing_digits(), unseen_digits()
    seen = reader.features(as_scenes(fixing.images))
    # Those of digits that are not admitted would shift what follows against its labels.
    if len(seen) != len(fixing):
        raise SystemExit("a digit that fixed the filter was not admitted: choose another seed")
    half = len(seen) // 2
    chosen = draw.choice(len(unseen), count, replace=False)
    odd = odd_scenes(unseen.images[chosen], draw)
    scenes = {
        "digits": as_scenes(unseen.images),
        "a face, drawn": odd["a face, drawn"],
        "a shape, drawn": shapes(count, draw),
        "half a digit": odd["half a digit"],
        "a digit, a fifth as bright": odd["a digit, a fifth as bright"],
    }
    looks = {name: reader.features(some) for name, some in scenes.items()}
    scores = {"energy": reader.energy, "distance": distance(seen[:half], fixing.labels[:half])}
    print(
        "refused where so many of the digits are: " + ", ".join(f"{each:.1%}" for each in REFUSED)
    )
    for score, of in scores.items():
        least = np.quantile(of(seen[half:]), [1 - share for share in REFUSED])
        for name, features in looks.items():
            refused = [np.mean(of(features) > each) for each in least]
            print(f"  {score:8}  {name:27}  " + "  ".join(f"{share:6.1%}" for share in refused))


if __name__ == "__main__":
    typer.run(main)
