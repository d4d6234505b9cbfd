"""Fresh part of a bundle, in place of pairs: distribution of masks, and one reader of all.

None of it is secret: masks come from a key that the camera alone has.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy.typing as npt

from veilcam_optics.arrays import Array, namespace
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.decoding import Decoder, MeasurementNoise, SceneFrame, SceneStatistics
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.masks import KEY_BYTES, MaskDistribution, draw_levels
from veilcam_optics.transfer.tables import Reach
from veilcam_training.bundle.errors import BundleError, require
from veilcam_training.bundle.layers import LayerRecord

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

    @property
    def inputs(self) -> int:
        """Number of inputs of the classifier: the values of a decoded scene."""
        return self.statistics.pixels

    def frame(
        self, camera: Camera, scene: Scene, embedding: Embedding
    ) -> SceneFrame[npt.NDArray[Any]]:
        """All that decoding needs besides the key of a mask."""
        known = (self.statistics, self.noise, self.reach, self.distribution)
        return SceneFrame(camera, scene, embedding, *known)


def classifier_inputs(decoder: Decoder[Array], measurements: Array) -> Array:
    """Return the classifier's input of measurements behind one mask: the estimated scenes.

    Args:
        decoder: decoder of that mask.
        measurements: (batch, rows, columns) of the embedding, (batch, 3, rows, columns) in colour,
            or (batch, embedding values).

    Returns:
        (batch, scene values).
    """
    inputs: Array = namespace(measurements).reshape(
        decoder(measurements), (measurements.shape[0], -1)
    )
    return inputs


def check_fresh(
    fresh: Fresh, camera: Camera, scene: Scene, embedding: Embedding, channels: int
) -> None:
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
    statistics, values = fresh.statistics, channels * scene.rows * scene.columns
    require(
        statistics.pixels == values,
        f"scene statistics are of {statistics.pixels} values: use {values} as the scene has",
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
