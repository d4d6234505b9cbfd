"""Digits that were measured behind masks, and how many of them a device reads right.

``measured`` makes them, with torch, on the machine that tests. What reads them is run by a device's
Python as a program, as ``python3 reading.py FILE``, and needs what a device has alone.
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

import numpy as np

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_server.demo_data import FRESH, load_digits
from veilcam_server.masks.fresh import FreshSource
from veilcam_training.bundle import Bundle, read_bundle

MASKS, BEHIND = 10, 25
"""As many captures as ``make demo`` takes, of the bundle with fresh masks."""
SNR_DB = 40.0


def key(number: int, bundle: Bundle) -> EpochKey:
    """Return a key that comes again in every run."""
    return EpochKey(number.to_bytes(32, "big"), device="d7" * 32, bundle=bundle.digest)


def measured(file: Path) -> None:
    """Write what the sensor measured of held-out digits, and what they are."""
    import torch

    from veilcam_optics.camera.masks import to_weights
    from veilcam_optics.sensor.noise import shot_noise
    from veilcam_optics.transfer.operator import TransferOperator

    digits, random = load_digits(), torch.Generator().manual_seed(0)
    bundle = read_bundle(FRESH)
    operator = TransferOperator(bundle.camera, bundle.scene, bundle.embedding)
    source, seen, truth = FreshSource(bundle), [], []
    with torch.inference_mode():
        for number in range(MASKS):
            mask = source.make(key(number, bundle), "none", frozenset())
            weights = torch.from_numpy(to_weights(mask.levels, bundle.camera.panel))
            some = torch.randint(len(digits), (BEHIND,), generator=random).numpy()
            scenes = torch.from_numpy(digits.images[some] / np.float32(255))
            clean = scenes.flatten(1) @ operator(weights)
            seen.append(shot_noise(clean, SNR_DB, random).numpy().astype(np.float32))
            truth.append(digits.labels[some])
    np.savez(file, seen=np.stack(seen), truth=np.stack(truth))


def read(file: Path) -> dict[str, str | float]:
    """Classify them; return the accuracy, a digest of all labels, and NumPy's version."""
    labels: list[str] = []
    right = 0
    bundle = read_bundle(FRESH)
    source = FreshSource(bundle)
    with np.load(file) as arrays:
        for number in range(MASKS):
            mask = source.make(key(number, bundle), "none", frozenset())
            for measurement, truth in zip(
                arrays["seen"][number], arrays["truth"][number], strict=True
            ):
                label = mask.reader.classify(measurement.reshape(bundle.embedding.shape)).label
                labels.append(label)
                right += label == bundle.labels[int(truth)]
    return {
        "accuracy": right / (MASKS * BEHIND),
        "labels": hashlib.sha256(" ".join(labels).encode()).hexdigest(),
        "numpy": np.__version__,
    }


if __name__ == "__main__":
    print(json.dumps(read(Path(sys.argv[1]))))  # noqa: T201
