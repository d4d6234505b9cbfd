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
import numpy.typing as npt

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_server.demo_data import BUNDLE, FRESH, load_digits
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.masks.pairs import load_pairs
from veilcam_server.masks.source import Mask
from veilcam_training.bundle import Bundle, read_bundle

BUNDLES = {"pairs": BUNDLE, "fresh": FRESH}
"""Those of ``make demo`` and of ``veilcamd demo --fresh``."""
MASKS, BEHIND = 5, 50
"""As many captures of each as ``make demo`` takes."""
SNR_DB = 40.0
Labels = npt.NDArray[np.uint8]


def key(number: int, bundle: Bundle) -> EpochKey:
    return EpochKey(number.to_bytes(32, "big"), device="d7" * 32, bundle=bundle.digest)


def masks(bundle: Bundle) -> list[Mask]:
    """Return masks that are the same in every run, of stored ones the first of the bundle."""
    if bundle.fresh is not None:
        fresh = FreshSource(bundle)
        return [fresh.make(key(number, bundle), frozenset()) for number in range(MASKS)]
    source, found = load_pairs(bundle), dict[bytes, Mask]()
    while len(found) < len(source.marks):
        known = frozenset(mask.mark for mask in found.values())
        mask = source.make(key(0, bundle), known)
        found[mask.levels.tobytes()] = mask
    return [found[pair.levels.tobytes()] for pair in bundle.pairs[:MASKS]]


def measured(file: Path) -> None:
    import torch

    from veilcam_optics.camera.masks import to_weights
    from veilcam_optics.sensor.noise import shot_noise
    from veilcam_optics.transfer.operator import TransferOperator

    digits, random = load_digits(), torch.Generator().manual_seed(0)
    seen: list[torch.Tensor] = []
    truth: list[Labels] = []
    for path in BUNDLES.values():
        bundle = read_bundle(path)
        operator = TransferOperator(bundle.camera, bundle.scene, bundle.embedding)
        for mask in masks(bundle):
            some = torch.randint(len(digits), (BEHIND,), generator=random).numpy()
            with torch.inference_mode():
                weights = torch.from_numpy(to_weights(mask.levels, bundle.camera.panel))
                scenes = torch.from_numpy(digits.images[some] / np.float32(255))
                clean = scenes.flatten(1) @ operator(weights)
                seen.append(shot_noise(clean, SNR_DB, random).float())
            truth.append(digits.labels[some])
    shape = (len(BUNDLES), MASKS, BEHIND)
    values = torch.stack(seen).numpy()
    np.savez(file, seen=values.reshape(*shape, -1), truth=np.stack(truth).reshape(shape))


def read(file: Path) -> dict[str, str | float]:
    found: dict[str, str | float] = {"numpy": np.__version__}
    labels: list[str] = []
    with np.load(file) as arrays:
        for (mode, path), seen, truths in zip(
            BUNDLES.items(), arrays["seen"], arrays["truth"], strict=True
        ):
            bundle, right = read_bundle(path), 0
            for mask, behind, truth in zip(masks(bundle), seen, truths, strict=True):
                for one, wanted in zip(behind, truth, strict=True):
                    label = mask.reader.classify(one.reshape(bundle.embedding.shape)).label
                    labels.append(label)
                    right += label == bundle.labels[int(wanted)]
            found[mode] = right / (MASKS * BEHIND)
    return {**found, "labels": hashlib.sha256(" ".join(labels).encode()).hexdigest()}


if __name__ == "__main__":
    print(json.dumps(read(Path(sys.argv[1]))))  # noqa: T201
