"""Refusal of bundles whose masks hide nothing."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
import numpy.typing as npt

from veilcam_optics.camera.masks import to_weights
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.masks import KEY_BYTES, draw_levels
from veilcam_optics.transfer.conditioning import Conditioning, ConditioningMeter
from veilcam_server.errors import BundleRevealsError
from veilcam_training.bundle import Bundle

LEAST = Conditioning(directions=0.75, spread=0.07, own=0.2)
"""What each mask has at least, as shares of what random ones have in the same camera. Measured on
both sides by ``python -m benchmarks.privacy.conditioning``; docs/bundle.md says what came of it."""
DRAWN = 4
"""Masks of mode ``fresh`` that are tried; none of them is ever shown."""


class HidingCheck:
    """Checks the masks of bundles for one camera.

    Args:
        bundle: bundle of that camera, scene and embedding.
    """

    def __init__(self, bundle: Bundle) -> None:
        self._geometry = (bundle.camera, bundle.scene, bundle.embedding)

    @cached_property
    def _meter(self) -> ConditioningMeter:
        return ConditioningMeter(*self._geometry)

    def __call__(self, bundle: Bundle) -> None:
        """Raise :class:`BundleRevealsError` for a mask that hides nothing; it is not described."""
        for index, weights in enumerate(_masks(bundle)):
            try:
                found = self._meter(weights)
            except OpticsError as error:
                raise BundleRevealsError(f"mask {index} cannot be measured: {error}") from None
            for name in ("directions", "spread", "own"):
                share, least = getattr(found, name), getattr(LEAST, name)
                if share < least:
                    raise BundleRevealsError(
                        f"mask {index} hides nothing ({name}: {share:.2f} of a random mask's, and "
                        f"{least:g} is the least): train another"
                    )


def _masks(bundle: Bundle) -> Iterator[npt.NDArray[np.float32]]:
    """Weights of all stored masks, or of some that the bundle's rule draws from known keys."""
    if bundle.fresh is None:
        for pair in bundle.pairs:
            yield to_weights(pair.levels, bundle.camera.panel)
        return
    for number in range(DRAWN):
        key = bytes([number]) * KEY_BYTES  # always the same: what is refused stays refused
        levels = draw_levels(key, camera=bundle.camera, distribution=bundle.fresh.distribution)
        yield to_weights(levels, bundle.camera.panel)
