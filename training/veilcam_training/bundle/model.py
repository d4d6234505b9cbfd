"""The nouns: a bundle is a task and a camera, and pairs of mask and classifier or a key policy."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import JsonValue

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.keys.masks import KEY_BYTES, draw_levels
from veilcam_optics.transfer.tables import Reach
from veilcam_training.bundle.card import PrivacyCard
from veilcam_training.bundle.classifier import (
    check_weights,
    count_operations,
    output_shape,
)
from veilcam_training.bundle.errors import BundleError, require
from veilcam_training.bundle.fresh import Fresh, check_fresh
from veilcam_training.bundle.hiding import Hiding, masks_digest
from veilcam_training.bundle.layers import LayerRecord
from veilcam_training.bundle.signature import OwnerKey
from veilcam_training.labels import labels_fault

MAX_PAIRS = 4096
MAX_LAYERS = 2**14
"""Of all classifiers of a bundle."""
MAX_OPERATIONS = 2**33
"""Products that all classifiers of a bundle may take for one sample each: some seconds."""
DRAWN = 4
"""Masks of mode ``fresh`` that are measured."""


@dataclass(frozen=True)
class Accuracy:
    """Share of ``samples`` of a test set that were classified right; ``value`` in [0, 1]."""

    value: float
    test_set: str
    samples: int

    def __post_init__(self) -> None:
        require(0 <= self.value <= 1, f"accuracy.value = {self.value} is not valid: use 0 to 1")
        require(
            self.samples >= 1, f"accuracy.samples = {self.samples} is not valid: use at least 1"
        )


@dataclass(frozen=True)
class LightPlan:
    """Plan of the light that a bundle was trained with; its numbers are of no mask in particular.

    Attributes:
        tolerance: relative L2 error asked for, at the embedding.
        error: relative L2 error predicted, over random masks, the field angle included.
        reached: True where the prediction is within the tolerance.
        method: way in which the light is computed.
        diffraction: False for geometric shadows.
        reach: distance up to which sub-pixels interfere.
        zones: parts of the field along each side.
        step: largest distance of integration nodes [m].
        dtype: number format.
    """

    tolerance: float
    error: float
    reached: bool
    method: Literal["transfer"]
    diffraction: bool
    reach: Reach
    zones: int
    step: float
    dtype: Literal["float32", "float64"]

    def __post_init__(self) -> None:
        require(
            0 < self.tolerance < 1
            and 0 <= self.error < math.inf
            and min(self.reach.rows, self.reach.columns) >= 0
            and self.zones >= 1
            and 0 < self.step < math.inf,
            f"light = {self} is not valid: use a tolerance between 0 and 1, an error >= 0, "
            "a reach >= 0, zones >= 1 and a step > 0",
        )


@dataclass(frozen=True)
class TransferError:
    """Relative L2 error of one mask's transfer against the full field, estimated.

    Attributes:
        value: value of the estimate.
        low: lower end of its interval of confidence.
        high: upper end.
        confidence: confidence of the interval, a share.
    """

    value: float
    low: float
    high: float
    confidence: float

    def __post_init__(self) -> None:
        require(
            0 <= self.low <= self.value <= self.high < math.inf and 0 < self.confidence < 1,
            f"transfer_error = {self} is not valid: use 0 <= low <= value <= high "
            "and a confidence between 0 and 1",
        )

    def __str__(self) -> str:
        return (
            f"{self.value:.2g} ({self.low:.2g} to {self.high:.2g} with a confidence of "
            f"{100 * self.confidence:.0f} %)"
        )


@dataclass(frozen=True)
class Pair:
    """One mask and the classifier trained for it. Both are secret: neither is in the repr."""

    levels: npt.NDArray[np.uint8] = field(repr=False)
    """What the panel shows, shape ``camera.mask_shape``, 0 to ``panel.levels - 1``."""
    layers: tuple[LayerRecord, ...]
    weights: Mapping[str, npt.NDArray[Any]] = field(repr=False)
    """By the names of the ``state_dict`` of torch's ``nn.Sequential``."""
    transfer_error: TransferError | None = None
    """Of the transfer as planned, at this mask; None if it was not measured."""


@dataclass(frozen=True)
class Bundle:
    """All that a daemon needs to classify: written by training, read by the server.

    Mode ``pairs`` holds masks and a classifier for each; mode ``fresh`` holds none, but says how
    to draw them from a key, and one classifier for all.
    """

    task: str
    labels: tuple[str, ...]
    camera: Camera
    scene: Scene
    embedding: Embedding
    mode: Literal["pairs", "fresh"]
    pairs: tuple[Pair, ...] = ()
    fresh: Fresh | None = None
    provenance: Mapping[str, JsonValue] = field(default_factory=dict)
    accuracy: Accuracy | None = None
    """Mean over the pairs."""
    light: LightPlan | None = None
    """Plan of the scene's light in training, of several grids the worst; None: none is known."""
    hiding: Hiding | None = None
    """Record of what attackers without a key found; None: not measured."""
    channels: Literal[1, 3] = 1
    """1 for a gray embedding, 3 for one per colour (R, G, B, each ``embedding.size`` long)."""
    version: int = 0
    """Of its owner's choice, from 1 on; 0 for one that has none."""
    owner: OwnerKey | None = None
    """Who signed the file that it was read from."""
    digest: str = ""
    """SHA-256 of the file that it was read from, hexadecimal."""
    subject: str = ""
    """What it is called by a card, which leaves out the card itself; see :mod:`.card`."""
    card: PrivacyCard | None = None
    """What attacks on it found, if the file holds that, and if it is of these masks."""

    @property
    def measurement_shape(self) -> tuple[int, ...]:
        """Shape of a measurement: (rows, columns), or (3, rows, columns) in colour."""
        return self.embedding.shape if self.channels == 1 else (3, *self.embedding.shape)

    @property
    def inputs(self) -> int:
        """Number of inputs of a classifier."""
        return self.channels * self.embedding.size if self.fresh is None else self.fresh.inputs

    def masks(self) -> Iterator[npt.NDArray[np.uint8]]:
        """Levels of all stored masks, or of some that the rule of mode ``fresh`` draws.

        Those are of known keys, the same every time; no panel ever shows them.
        """
        if self.fresh is None:
            yield from (pair.levels for pair in self.pairs)
            return
        for number in range(DRAWN):
            key = bytes([number]) * KEY_BYTES
            yield draw_levels(key, camera=self.camera, distribution=self.fresh.distribution)

    @property
    def masks_digest(self) -> str:
        """SHA-256 of all masks in their order, or of the distribution of mode ``fresh``."""
        if self.fresh is None:
            return masks_digest(pair.levels for pair in self.pairs)
        drawn = self.fresh.distribution
        return masks_digest((drawn.lowest, drawn.highest, drawn.curve))

    @property
    def valid_hiding(self) -> Hiding | None:
        """Record of hiding, if it is of these masks."""
        record = self.hiding
        return record if record is not None and record.digest == self.masks_digest else None

    @property
    def transfer_error(self) -> TransferError | None:
        """Error of the pair where it is largest; None unless it was measured for every pair."""
        known = [pair.transfer_error for pair in self.pairs if pair.transfer_error is not None]
        if not known or len(known) < len(self.pairs):
            return None
        return max(known, key=lambda error: error.value)


def check_bundle(bundle: Bundle) -> None:
    """Raise :class:`BundleError` unless every part of ``bundle`` fits every other."""
    require(1 <= len(bundle.task) <= 64, "task is not valid: use a name of 1 to 64 letters")
    if (fault := labels_fault(bundle.labels)) is not None:
        raise BundleError(fault)
    records = bundle.pairs if bundle.fresh is None else (bundle.fresh,)
    require(
        sum(len(record.layers) for record in records) <= MAX_LAYERS,
        f"all classifiers together have too many layers: use {MAX_LAYERS}",
    )
    if bundle.mode == "fresh":
        _check_fresh(bundle)
    elif bundle.mode == "pairs":
        _check_pairs(bundle)
    else:
        raise BundleError(f"mode = {bundle.mode} is not valid: use 'pairs' or 'fresh'")
    products = sum(count_operations(record.layers, bundle.inputs) for record in records)
    require(
        products <= MAX_OPERATIONS,
        f"all classifiers together take {products} products: use at most {MAX_OPERATIONS}",
    )
    shown = {pair.levels.tobytes() for pair in bundle.pairs}
    require(
        len(bundle.pairs) < 2 or len(shown) > 1,
        f"all {len(bundle.pairs)} masks are the same: use pairs of different masks",
    )


def _check_fresh(bundle: Bundle) -> None:
    fresh = bundle.fresh
    if fresh is None or bundle.pairs:
        raise BundleError("mode 'fresh' has a key policy and no pairs: export the bundle again")
    check_fresh(fresh, bundle.camera, bundle.scene, bundle.embedding, bundle.channels)
    _check_classifier(bundle, fresh.layers, fresh.weights)


def _check_pairs(bundle: Bundle) -> None:
    if bundle.fresh is not None:
        raise BundleError("mode 'pairs' has no key policy: export the bundle again")
    require(
        1 <= len(bundle.pairs) <= MAX_PAIRS,
        f"the bundle holds {len(bundle.pairs)} pairs: use 1 to {MAX_PAIRS}",
    )
    for index, pair in enumerate(bundle.pairs):
        try:
            _check_pair(bundle, pair)
        except BundleError as error:
            raise BundleError(f"pair {index}: {error}") from None


def _check_pair(bundle: Bundle, pair: Pair) -> None:
    require(
        pair.levels.dtype == np.uint8 and pair.levels.shape == bundle.camera.mask_shape,
        f"mask is {pair.levels.dtype} {pair.levels.shape}: "
        f"use uint8 {bundle.camera.mask_shape} as the camera's window",
    )
    top = bundle.camera.panel.levels - 1
    require(
        int(np.max(pair.levels)) <= top,
        f"mask exceeds what the panel can show: use levels 0 to {top}",
    )
    _check_classifier(bundle, pair.layers, pair.weights)


def _check_classifier(
    bundle: Bundle, layers: tuple[LayerRecord, ...], weights: Mapping[str, npt.NDArray[Any]]
) -> None:
    shape = output_shape(layers, bundle.inputs)
    require(
        shape == (len(bundle.labels),),
        f"classifier gives shape {shape} ({math.prod(shape)} numbers) "
        f"for {len(bundle.labels)} labels: train it again",
    )
    check_weights(layers, weights)
