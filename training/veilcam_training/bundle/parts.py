"""The arrays of a bundle as safetensors parts, and back."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import safetensors.numpy
from safetensors import SafetensorError

from veilcam_optics.decoding import SceneStatistics
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_training.bundle.errors import BundleError, require
from veilcam_training.bundle.fresh import Fresh
from veilcam_training.bundle.manifest import FreshManifest, PairManifest
from veilcam_training.bundle.model import Bundle, Pair

Values = npt.NDArray[Any]

MASKS, WEIGHTS, SCENES = "masks.safetensors", "weights.safetensors", "scene_stats.safetensors"
PARTS: Mapping[str, tuple[str, ...]] = {
    "pairs": (MASKS, WEIGHTS),
    "fresh": (MASKS, WEIGHTS, SCENES),
}
"""The parts of each mode, besides ``bundle.json``."""

_DISTRIBUTION = ("lowest", "highest", "curve")
_STATISTICS = ("mean", "basis", "residual")


def dump_parts(bundle: Bundle) -> dict[str, bytes]:
    """Every part of a checked bundle but ``bundle.json``, by name."""
    if bundle.fresh is None:
        masks = {f"pair.{i}.levels": pair.levels for i, pair in enumerate(bundle.pairs)}
        weights = {
            f"pair.{i}.{name}": array
            for i, pair in enumerate(bundle.pairs)
            for name, array in pair.weights.items()
        }
        return {MASKS: _dump(masks), WEIGHTS: _dump(weights)}
    fresh = bundle.fresh
    statistics = fresh.statistics.to("float32")
    return {
        MASKS: _dump({name: getattr(fresh.distribution, name) for name in _DISTRIBUTION}),
        WEIGHTS: _dump({f"classifier.{n}": a for n, a in fresh.weights.items()}),
        SCENES: _dump({name: getattr(statistics, name) for name in _STATISTICS}),
    }


def load_pairs(pairs: tuple[PairManifest, ...], parts: Mapping[str, bytes]) -> tuple[Pair, ...]:
    """Masks and weights with the layers that they belong to.

    Raises:
        BundleError: a part that is no safetensors file, or holds too much or too little.
    """
    masks, weights = _load(parts[MASKS]), _load(parts[WEIGHTS])
    count = len(pairs)
    require(
        masks.keys() == {f"pair.{index}.levels" for index in range(count)},
        f"{MASKS} does not hold one mask for each of {count} pairs",
    )
    sorted_weights: list[dict[str, Values]] = [{} for _ in range(count)]
    for key, array in weights.items():
        prefix, _, rest = key.partition(".")
        index, _, name = rest.partition(".")
        require(
            prefix == "pair" and index.isdecimal() and str(int(index)) == index,
            f"{WEIGHTS} holds unknown {key!r}: export the bundle again",
        )
        require(int(index) < count, f"{WEIGHTS} holds {key!r} but there are {count} pairs")
        sorted_weights[int(index)][name] = array
    return tuple(
        Pair(masks[f"pair.{index}.levels"], pair.layers, own, pair.transfer_error)
        for index, (pair, own) in enumerate(zip(pairs, sorted_weights, strict=True))
    )


def load_fresh(manifest: FreshManifest, parts: Mapping[str, bytes]) -> Fresh:
    """Key policy, statistics and classifier of mode ``fresh``.

    Raises:
        BundleError: as :func:`load_pairs`, or arrays that are no distribution or statistics.
    """
    arrays, weights = _load(parts[MASKS]), _load(parts[WEIGHTS])
    scenes = _load(parts[SCENES])
    for name, found, wanted in (
        (MASKS, arrays.keys(), _DISTRIBUTION),
        (SCENES, scenes.keys(), _STATISTICS),
    ):
        require(
            found == set(wanted),
            f"{name} does not hold {', '.join(wanted)}: export the bundle again",
        )
    require(
        all(array.dtype == np.float32 for array in scenes.values()),
        f"{SCENES} is not float32: export the bundle again",
    )
    own = {}
    for key, array in weights.items():
        prefix, _, name = key.partition(".")
        require(prefix == "classifier", f"{WEIGHTS} holds unknown {key!r}: export the bundle again")
        own[name] = array
    try:
        return Fresh(
            distribution=MaskDistribution(**arrays),
            statistics=SceneStatistics(**scenes),
            noise=manifest.noise,
            layers=manifest.layers,
            weights=own,
            reach=manifest.reach,
        )
    except OpticsError as error:
        raise BundleError(str(error)) from None


def _dump(arrays: Mapping[str, Values]) -> bytes:
    return safetensors.numpy.save({n: np.asarray(a, order="C") for n, a in arrays.items()})


def _load(data: bytes) -> dict[str, Values]:
    try:
        return safetensors.numpy.load(data)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise BundleError(f"a part is not a safetensors file: {error}") from None
