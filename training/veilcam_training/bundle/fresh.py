"""Fresh part of a bundle, in place of pairs: distribution of masks, and one reader of all.

None of it is secret: masks come from a key that the camera alone has.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy.typing as npt

from veilcam_optics.arrays import Array, namespace
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.decoding import Decoder, MeasurementNoise, SceneFrame, SceneStatistics
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.masks import KEY_BYTES, MaskDistribution, draw_levels
from veilcam_optics.transfer.tables import Reach
from veilcam_training.bundle.errors import BundleError, require
from veilcam_training.bundle.layers import LayerRecord

Feature = Literal["estimate", "deviation"]
"""``estimate`` is the decoded scene, ``deviation`` its posterior standard deviation."""

FEATURES: tuple[Feature, ...] = ("estimate", "deviation")

MAX_RESPONSE = 2**26
"""Most numbers in a transfer matrix: 256 MiB of float32."""
LEAST_BITS = 128.0
"""Least entropy of one mask [bit]: below it, guessing a mask is easier than guessing a key."""


@dataclass(frozen=True)
class Fresh:
    """Key policy, scene statistics and the one classifier that serves all masks."""

    distribution: MaskDistribution
    """What masks are drawn from; its curve holds the levels that the panel can show."""
    statistics: SceneStatistics[npt.NDArray[Any]]
    noise: MeasurementNoise
    layers: tuple[LayerRecord, ...]
    weights: Mapping[str, npt.NDArray[Any]] = field(repr=False)
    """By the names of the ``state_dict`` of torch's ``nn.Sequential``."""
    reach: Reach = field(default_factory=Reach)
    features: tuple[Feature, ...] = FEATURES
    """What the classifier is given, each as large as the scene, one after the other."""

    @property
    def inputs(self) -> int:
        """Number of inputs of the classifier."""
        return len(self.features) * self.statistics.pixels

    def frame(
        self, camera: Camera, scene: Scene, embedding: Embedding
    ) -> SceneFrame[npt.NDArray[Any]]:
        """All that decoding needs besides the key of a mask."""
        known = (self.statistics, self.noise, self.reach, self.distribution)
        return SceneFrame(camera, scene, embedding, *known)


def classifier_inputs(
    decoder: Decoder[Array], measurements: Array, features: tuple[Feature, ...] = FEATURES
) -> Array:
    """Return the classifier's input of measurements behind one mask.

    Args:
        decoder: decoder of that mask.
        measurements: (batch, rows, columns) of the embedding, or (batch, embedding pixels).
        features: each as large as the scene, one after the other.

    Returns:
        (batch, features x scene pixels).
    """
    xp = namespace(measurements)
    estimate = decoder(measurements)
    shape = (estimate.shape[0], decoder.scene.rows * decoder.scene.columns)
    deviation = xp.broadcast_to(xp.reshape(decoder.deviation, (1, shape[1])), shape)
    known = {"estimate": xp.reshape(estimate, shape), "deviation": deviation}
    inputs: Array = xp.concat([known[feature] for feature in features], axis=1)
    return inputs


def check_fresh(fresh: Fresh, camera: Camera, scene: Scene, embedding: Embedding) -> None:
    """Raise :class:`BundleError` unless key policy and statistics fit camera and scene."""
    try:
        # What draws knows what it can serve; nobody is ever shown this mask.
        draw_levels(bytes(KEY_BYTES), camera=camera, distribution=fresh.distribution)
    except OpticsError as error:
        raise BundleError(f"key policy: {error}") from None
    require(
        fresh.distribution.bits >= LEAST_BITS,
        f"key policy: a mask holds {fresh.distribution.bits:.0f} bits: "
        f"use a distribution with at least {LEAST_BITS:.0f}",
    )
    statistics = fresh.statistics
    require(
        statistics.pixels == scene.rows * scene.columns,
        f"scene statistics are of {statistics.pixels} pixels: "
        f"use {scene.rows * scene.columns} as the scene has",
    )
    require(
        statistics.rank <= statistics.pixels,
        f"scene statistics have rank {statistics.rank}: use at most {statistics.pixels}",
    )
    require(
        statistics.pixels * embedding.size <= MAX_RESPONSE,
        f"scene and embedding make {statistics.pixels} x {embedding.size} responses: "
        f"use at most {MAX_RESPONSE}",
    )
    require(
        0 < len(fresh.features) == len(set(fresh.features)),
        f"features = {fresh.features} are not valid: use each once at most",
    )
