"""Refusal of bundles whose masks show pictures of the scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt
import structlog

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.errors import OpticsError
from veilcam_optics.transfer.conditioning import ConditioningMeter
from veilcam_server.errors import BundleRefusedError
from veilcam_training.bundle import Bundle, shows
from veilcam_training.hiding.eye import Eye

LEAST = 0.75
"""Directions that each mask has at least, as a share of those of random masks."""

log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class HidingCheck:
    """Checks the masks of bundles.

    Args:
        allow: True takes a bundle that shows pictures of the scene, with a warning.
    """

    allow: bool = False

    def __call__(self, bundle: Bundle) -> None:
        """Raise :class:`BundleRefusedError` for a mask that shows pictures; it is not described."""
        try:
            _check_blur(bundle)
            _check_eye(bundle)
        except OpticsError as error:
            raise BundleRefusedError(f"a mask cannot be measured: {error}") from None
        except BundleRefusedError as error:
            if not self.allow:
                raise
            log.warning("bundle taken all the same", reason=str(error))


def _check_blur(bundle: Bundle) -> None:
    meter = _meter(bundle.camera, bundle.scene, bundle.embedding)
    for number, weights in enumerate(_masks(bundle)):
        found = meter.directions(weights)
        if found < LEAST:
            raise BundleRefusedError(
                f"mask {number} shows pictures of the scene, out of focus (directions: {found:.2f} "
                f"of a random mask's, and {LEAST:g} is the least): train another"
            )


def _check_eye(bundle: Bundle) -> None:
    """Look through every mask, unless the bundle holds a record of just these."""
    record = bundle.valid_hiding
    if record is not None:
        if record.visible:
            raise _shown(record.worst, record.seen, record.random_seen)
        return
    eye = _eye(bundle.camera, bundle.scene, bundle.embedding, bundle.channels)
    for number, weights in enumerate(_masks(bundle)):
        seen = eye.seen(weights)
        if shows(seen, eye.random, eye.pinhole):
            raise _shown(number, seen, eye.random)


def _shown(number: int, seen: float, random: float) -> BundleRefusedError:
    return BundleRefusedError(
        f"mask {number} shows pictures of the scene (an eye picks {100 * seen:.0f} % of scenes out "
        f"of a hundred, and {100 * random:.0f} % behind random masks): train another"
    )


@lru_cache(maxsize=2)
def _meter(camera: Camera, scene: Scene, embedding: Embedding) -> ConditioningMeter:
    return ConditioningMeter(camera, scene, embedding)


@lru_cache(maxsize=2)
def _eye(camera: Camera, scene: Scene, embedding: Embedding, channels: Literal[1, 3]) -> Eye:
    return Eye(camera, scene, embedding, channels)


def _masks(bundle: Bundle) -> Iterator[npt.NDArray[np.float32]]:
    """Weights of all stored masks, or of some that the bundle's rule draws from known keys."""
    for levels in bundle.masks():
        yield to_weights(levels, bundle.camera.panel)
