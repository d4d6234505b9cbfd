"""The arrays of a bundle as safetensors parts, and back."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import safetensors.numpy
import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor

from veilcam_optics.decoding import SceneStatistics
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_training.bundle.errors import BundleError, require
from veilcam_training.bundle.fresh import Fresh
from veilcam_training.bundle.manifest import FreshManifest, PairManifest
from veilcam_training.bundle.model import Bundle, Pair

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
            f"pair.{i}.{name}": tensor
            for i, pair in enumerate(bundle.pairs)
            for name, tensor in pair.weights.items()
        }
        return {MASKS: _dump_masks(masks), WEIGHTS: _dump_tensors(weights)}
    fresh = bundle.fresh
    statistics = fresh.statistics.to("float32")
    return {
        MASKS: _dump_masks({name: getattr(fresh.distribution, name) for name in _DISTRIBUTION}),
        WEIGHTS: _dump_tensors({f"classifier.{n}": t for n, t in fresh.weights.items()}),
        SCENES: _dump_tensors({name: getattr(statistics, name) for name in _STATISTICS}),
    }


def load_pairs(pairs: tuple[PairManifest, ...], parts: Mapping[str, bytes]) -> tuple[Pair, ...]:
    """Masks and weights with the layers that they belong to.

    Raises:
        BundleError: a part that is no safetensors file, or holds too much or too little.
    """
    masks, weights = _load_masks(parts[MASKS]), _load_tensors(parts[WEIGHTS])
    count = len(pairs)
    require(
        masks.keys() == {f"pair.{index}.levels" for index in range(count)},
        f"{MASKS} does not hold one mask for each of {count} pairs",
    )
    sorted_weights: list[dict[str, Tensor]] = [{} for _ in range(count)]
    for key, tensor in weights.items():
        prefix, _, rest = key.partition(".")
        index, _, name = rest.partition(".")
        require(
            prefix == "pair" and index.isdecimal() and str(int(index)) == index,
            f"{WEIGHTS} holds unknown {key!r}: export the bundle again",
        )
        require(int(index) < count, f"{WEIGHTS} holds {key!r} but there are {count} pairs")
        sorted_weights[int(index)][name] = tensor
    return tuple(
        Pair(levels=masks[f"pair.{index}.levels"], layers=pair.layers, weights=own)
        for index, (pair, own) in enumerate(zip(pairs, sorted_weights, strict=True))
    )


def load_fresh(manifest: FreshManifest, parts: Mapping[str, bytes]) -> Fresh:
    """Key policy, statistics and classifier of mode ``fresh``.

    Raises:
        BundleError: as :func:`load_pairs`, or arrays that are no distribution or statistics.
    """
    arrays, weights = _load_masks(parts[MASKS]), _load_tensors(parts[WEIGHTS])
    scenes = _load_tensors(parts[SCENES])
    for name, found, wanted in (
        (MASKS, arrays.keys(), _DISTRIBUTION),
        (SCENES, scenes.keys(), _STATISTICS),
    ):
        require(
            found == set(wanted),
            f"{name} does not hold {', '.join(wanted)}: export the bundle again",
        )
    require(
        all(tensor.dtype == torch.float32 for tensor in scenes.values()),
        f"{SCENES} is not float32: export the bundle again",
    )
    own = {}
    for key, tensor in weights.items():
        prefix, _, name = key.partition(".")
        require(prefix == "classifier", f"{WEIGHTS} holds unknown {key!r}: export the bundle again")
        own[name] = tensor
    try:
        return Fresh(
            distribution=MaskDistribution(**arrays),
            statistics=SceneStatistics(**scenes),
            noise=manifest.noise,
            layers=manifest.layers,
            weights=own,
            reach=manifest.reach,
            features=manifest.features,
        )
    except OpticsError as error:
        raise BundleError(str(error)) from None


def _dump_masks(arrays: Mapping[str, npt.NDArray[np.uint8]]) -> bytes:
    return safetensors.numpy.save({n: np.ascontiguousarray(a) for n, a in arrays.items()})


def _dump_tensors(tensors: Mapping[str, Tensor]) -> bytes:
    return safetensors.torch.save({n: t.detach().cpu().contiguous() for n, t in tensors.items()})


def _load_masks(data: bytes) -> dict[str, npt.NDArray[np.uint8]]:
    try:
        return safetensors.numpy.load(data)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise BundleError(f"a part is not a safetensors file: {error}") from None


def _load_tensors(data: bytes) -> dict[str, Tensor]:
    try:
        return safetensors.torch.load(data)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise BundleError(f"a part is not a safetensors file: {error}") from None
