"""What sealing costs, and what the holder of a receiver's key reads: time and accuracy."""

from __future__ import annotations

import secrets
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import torch
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from torch import Tensor

from veilcam_client.keys.blocks import Opener, Sealer
from veilcam_client.keys.envelopes import open_key, seal_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import Capture, Exposure, Notes, Timing
from veilcam_client.wire.sealing import Release
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.keys.masks import draw_levels
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach
from veilcam_server.camera.budget import ReleaseBudget
from veilcam_server.camera.epochs import Preparation
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.masks.source import Mask, Terms
from veilcam_server.sealing.identity import DeviceKey
from veilcam_training.bundle import Bundle, classifier_inputs
from veilcam_training.data import Images
from veilcam_training.models.network import build_classifier

NOTES = Notes(
    exposure=Exposure(started_after_shown_s=0.104, settle_s=0.1, duration_s=0.01),
    timing=Timing(queue_s=0.0, rotation_s=0.02, settle_s=0.08, capture_s=0.05),
)
_WARM_UP = 3
SNR_DB = 40.0
Floats32 = npt.NDArray[np.float32]

ResultT = TypeVar("ResultT")


class Camera:
    """Draws masks as the daemon does, and reads scenes behind them with noise.

    The light has interference of terms that the decoder does not know of, and noise at 40 dB.

    Args:
        bundle: of mode fresh.
    """

    def __init__(self, bundle: Bundle) -> None:
        self.bundle, self._source = bundle, FreshSource(bundle)
        self._light = TransferOperator(
            bundle.camera, bundle.scene, bundle.embedding, reach=Reach(6, 1), dtype=torch.float32
        )

    def mask_of(self, key: EpochKey) -> Mask:
        """The mask of an epoch."""
        return self._source.make(key, frozenset())

    def read(self, mask: Mask, scene: Tensor, noise: torch.Generator) -> Floats32:
        """Measurement of a scene (rows, columns), float32."""
        weights = torch.from_numpy(to_weights(mask.levels, self.bundle.camera.panel)).float()
        with torch.no_grad():
            light = self._light.embed(scene[None], weights)
        measured: Floats32 = shot_noise(light, SNR_DB, noise).numpy()[0]
        return measured


class Ends:
    """A device that seals, and a receiver that opens."""

    def __init__(self, bundle: str) -> None:
        self.device, self.receiver = DeviceKey(Ed25519PrivateKey.generate()), ReceiverKey.generate()
        self.opener, self._bundle = Opener(self.receiver, self.device.public), bundle

    def epoch(self) -> tuple[EpochKey, Sealer, str]:
        """A new epoch's key, what seals under it, and its name."""
        key = EpochKey.generate(device=self.device.public, bundle=self._bundle)
        name, receivers = secrets.token_hex(16), (self.receiver.public,)
        envelope = seal_key(key, self.device, epoch=name, bundle=self._bundle, receivers=receivers)
        return key, Sealer(key, envelope), name


def sealed(sealer: Sealer, epoch: str, number: int, measurement: Floats32) -> Capture:
    """One capture as it leaves."""
    taken_at = datetime.now(UTC).replace(microsecond=0)
    embedding = sealer.seal(number, taken_at, measurement, NOTES)
    return Capture(
        id=secrets.token_hex(8),
        epoch=epoch,
        number=number,
        taken_at=taken_at,
        embedding=embedding,
    )


def sealing_times(bundle: Bundle, measurement: Floats32, rounds: int) -> dict[str, float]:
    """Milliseconds of the processor for a block, and for an envelope that comes first.

    Returns:
        Medians: ``seal`` a block; ``open`` one of an epoch that is known; ``open_first`` one with
        the epoch's envelope; ``envelope``: seal an epoch's key to one receiver.
    """
    ends = Ends(bundle.digest)
    took: dict[str, list[float]] = {"envelope": [], "seal": [], "open_first": [], "open": []}
    for _ in range(_WARM_UP + rounds):
        (_, sealer, name), seconds = _timed(ends.epoch)
        took["envelope"].append(seconds)
        for number, opening in enumerate(("open_first", "open")):
            capture, seconds = _timed(lambda: sealed(sealer, name, number, measurement))  # noqa: B023
            took["seal"].append(seconds)
            opened, seconds = _timed(lambda: ends.opener.open(capture))  # noqa: B023
            if opened.notes != NOTES:
                raise RuntimeError("what was opened is not what was sealed")
            took[opening].append(seconds)
    return {name: 1e3 * statistics.median(each[_WARM_UP:]) for name, each in took.items()}


def preparation_times(bundle: Bundle, folder: Path, rounds: int) -> dict[str, float]:
    """Milliseconds of the processor for preparing an epoch.

    Returns:
        Medians, all measured in turn: ``mask``, a mask and what reads it alone, and the whole epoch
        in each form.
    """
    source, ends = FreshSource(bundle), Ends(bundle.digest)
    key = EpochKey.generate(device=ends.device.public, bundle=bundle.digest)
    forms: Sequence[Release] = ("none", "sealed")
    budget = ReleaseBudget(folder, raw=0)
    prepare = {
        form: Preparation(source, ends.device, _terms(form, ends.receiver), budget)
        for form in forms
    }
    took: dict[str, list[float]] = {name: [] for name in ("mask", *forms)}
    try:
        for _ in range(_WARM_UP + rounds):
            mask, seconds = _timed(lambda: source.make(key, frozenset()))
            took["mask"].append(seconds)
            mask.erase()
            for form, preparation in prepare.items():
                epoch, seconds = _timed(preparation.take)
                took[form].append(seconds)
                epoch.retire()
    finally:
        for preparation in prepare.values():
            preparation.close()
    return {name: 1e3 * statistics.median(each[_WARM_UP:]) for name, each in took.items()}


def _terms(form: Release, receiver: ReceiverKey) -> Callable[[], Terms]:
    return lambda: Terms(form, (receiver.public,) if form == "sealed" else ())


def _timed(run: Callable[[], ResultT]) -> tuple[ResultT, float]:
    """Time of the processor, all threads: whatever else keeps the machine busy does not count."""
    begun = time.process_time()
    result = run()
    return result, time.process_time() - begun


@dataclass(frozen=True)
class Read:
    """One digit, as it is, as the daemon reads it and as the key's holder does."""

    truth: str
    daemon: str
    holder: str


def read_sealed(bundle: Bundle, images: Images, seed: int) -> Iterator[Read]:
    """Read each image behind a mask of its own, sealed and opened in between.

    The daemon classifies what its sensor read; the holder of a receiver's key opens the block,
    draws the mask again, prepares the decoder and classifies. Nothing else is common to both.
    """
    fresh = bundle.fresh
    if fresh is None:
        raise ValueError("a bundle of mode pairs has no fresh masks")
    camera, ends = Camera(bundle), Ends(bundle.digest)
    frame = fresh.frame(bundle.camera, bundle.scene, bundle.embedding).in_torch()
    decoding, noise = frame.decoding(), torch.Generator().manual_seed(seed)
    classifier = build_classifier(fresh.layers, fresh.weights).eval()
    for number, label in enumerate(images.labels.tolist()):
        key, sealer, name = ends.epoch()
        mask = camera.mask_of(key)
        key.erase()
        measurement = camera.read(mask, images.scenes(slice(number, number + 1))[0], noise)
        said = mask.reader.classify(measurement).label
        capture = sealed(sealer, name, 0, measurement)
        mask.erase()
        sealer.erase()
        envelope = capture.embedding.envelope  # type: ignore[union-attr]
        again = open_key(envelope, ends.receiver, device=ends.device.public)
        levels = draw_levels(again.levels(), camera=bundle.camera, distribution=fresh.distribution)
        opened = torch.tensor(ends.opener.open(capture).embedding.values)  # type: ignore[union-attr]
        with torch.inference_mode():
            decoder = decoding.prepare(frame.shown(levels))
            inputs = classifier_inputs(decoder, opened[None])
            place = int(classifier(inputs).argmax())
        yield Read(bundle.labels[label], said, bundle.labels[place])
