"""Which digits are lost when they are 2 to 20 cm tall: accuracy by height.

Takes the bundle of a finished cell (`python -m benchmarks.paper robust --changes rescale`) and
shows it the validation images at heights drawn as in training, noise included. Beside it, how many
millimetres the digit's shadow measures on the sensor, and how many boxes of the embedding that is.

    python -m benchmarks.training.rescale --data data/mnist --bundle PAIR.veilcam
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated

import torch
import typer

from veilcam_optics.camera.masks import to_weights
from veilcam_training.bundle import read_bundle
from veilcam_training.data import open_source, split
from veilcam_training.encoders import FixedEncoder, Setup
from veilcam_training.encoders.imperfections import make_operators
from veilcam_training.models.lensless import LenslessClassifier
from veilcam_training.seeding import stream
from veilcam_training.transforms.scene import Rescale

EDGES = (0.02, 0.025, 0.03, 0.04, 0.05, 0.07, 0.10, 0.15, 0.20)
SNR_DB = 40.0


@torch.inference_mode()
def main(
    *,
    data: Annotated[Path, typer.Option(help="Folder with MNIST's four idx files.")],
    bundle: Annotated[Path, typer.Option(help="Of a mask and classifier fitted to `rescale`.")],
) -> None:
    """Print accuracy by height."""
    found = read_bundle(bundle)
    pair, camera = found.pairs[0], found.camera
    source = open_source("mnist", data)
    change = Rescale(source.scene)
    setup = Setup(camera, change.scene, found.embedding, finer=change.finer)
    weights = torch.from_numpy(to_weights(pair.levels, camera.panel))
    encoder = FixedEncoder(setup, [operator(weights) for operator in make_operators(setup)])
    model = LenslessClassifier(encoder, pair.layers, SNR_DB, change=change)
    model.classifier.load_state_dict(pair.weights)
    model.eval()
    images = split(source.training()).validation
    count = len(images)
    heights = change.draw_heights(count, stream(0, "heights"))
    shown = images.scenes(slice(0, count))
    logits = model(shown, stream(0, "noise"), stream(0, "heights"))
    right = logits.argmax(1) == images.labels
    box = camera.sensor.height / found.embedding.rows
    print("      height  on the sensor  boxes  digits  read right")
    for low, high in pairwise(EDGES):
        some = right[(low <= heights) & (heights < high)]
        shadows = [height * camera.distance / source.scene.distance for height in (low, high)]
        print(
            f"{100 * low:4.1f} to {100 * high:4.1f} cm"
            f"  {1e3 * shadows[0]:4.2f} to {1e3 * shadows[1]:4.2f} mm"
            f"  {shadows[0] / box:4.1f}  {len(some):5}  {100 * some.float().mean():6.1f} %"
        )
    print(f"all {100 * right.float().mean():.2f} %")


if __name__ == "__main__":
    typer.run(main)
