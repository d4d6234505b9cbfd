"""Which digits are lost when they are 2 to 20 cm tall: accuracy by height.

Takes the bundle of a finished cell (`veilcam-train table robust --changes rescale`) and shows the
validation images to it at one height after the other, noise as in training. Beside it, how many
millimetres the digit's shadow measures on the sensor, and how many boxes of the embedding that is.

    python benchmarks/training_rescale.py --data data/mnist --bundle PAIR.veilcam
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import torch
import typer

from veilcam_optics.masks import to_weights
from veilcam_optics.noise import shot_noise
from veilcam_optics.transfer import TransferOperator
from veilcam_training.bundle import build_classifier, read_bundle
from veilcam_training.changes import HEIGHTS, Rescale
from veilcam_training.data import open_source, split

HEIGHTS_SHOWN = (0.02, 0.03, 0.04, 0.06, 0.08, 0.10, 0.12, 0.15, 0.20)
SNR_DB = 40.0


@torch.inference_mode()
def main(
    *,
    data: Annotated[Path, typer.Option(help="Folder with MNIST's four idx files.")],
    bundle: Annotated[Path, typer.Option(help="Of a mask and classifier fitted to `rescale`.")],
    count: Annotated[int, typer.Option(min=1, help="Validation images.")] = 2000,
) -> None:
    """Print accuracy by height."""
    found = read_bundle(bundle)
    pair, camera = found.pairs[0], found.camera
    source = open_source("mnist", data)
    scene = Rescale(source.scene, HEIGHTS).scene
    transfer = TransferOperator(camera, scene, found.embedding)(
        to_weights(pair.levels, camera.panel)
    )
    classifier = build_classifier(pair.layers, pair.weights)
    images = split(source.training()).validation
    noise, draws = torch.Generator().manual_seed(0), torch.Generator().manual_seed(0)
    box = camera.sensor.height / found.embedding.rows
    print(" height  on the sensor   boxes  accuracy")
    for height in HEIGHTS_SHOWN:
        change = Rescale(source.scene, (height, height))
        change.scene = scene
        right = 0
        for part in torch.split(torch.arange(min(count, len(images))), 500):
            shown = change(images.scenes(part), draws).flatten(1)
            logits = classifier(shot_noise(shown @ transfer, SNR_DB, noise))
            right += int((logits.argmax(1) == images.labels[part]).sum())
        shadow = height * camera.distance / scene.distance
        place = f"{100 * height:4.0f} cm  {1e3 * shadow:10.2f} mm  {shadow / box:6.1f}"
        print(f"{place}  {100 * right / min(count, len(images)):6.1f} %")


if __name__ == "__main__":
    typer.run(main)
