"""A small camera and blurred pictures, for attacks that go through the optics."""

from __future__ import annotations

import math

import torch
from scipy.stats import binom
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.decoding import SceneDecoding, fit_statistics
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.attacks.victim import ReleaseRule, StoredMasks, Victim

CAMERA = Camera(window=Window(rows=12, columns=6))
SCENE = Scene(rows=8, columns=8)
GALLERY = 20
"""Pictures that a capture is looked up in: chance finds one in so many."""


def pictures(count: int, seed: int, *, ground: float = 0.0) -> Tensor:
    """Two blobs each, anywhere on an even ground, (count, 8, 8) in [0, 1]."""
    generator = torch.Generator().manual_seed(seed)
    middles = 7 * torch.rand(count, 2, 2, 1, 1, generator=generator)
    along, across = torch.arange(8.0)[:, None], torch.arange(8.0)[None]
    apart = (along - middles[:, :, 0]).square() + (across - middles[:, :, 1]).square()
    return ground + (1 - ground) * torch.exp(-apart / 2).sum(1).clamp_max(1)


def make_decoding(*, ground: float = 0.0) -> SceneDecoding:
    """What is public: the operator of a 6 x 8 embedding, and statistics of such pictures."""
    operator = TransferOperator(CAMERA, SCENE, Embedding(6, 8))
    return SceneDecoding(operator, fit_statistics([pictures(2000, seed=1, ground=ground)], rank=40))


def make_victim(
    decoding: SceneDecoding,
    release: ReleaseRule,
    *,
    masks: int = 1,
    exponent: float = 1.0,
    seed: int = 0,
) -> Victim:
    """A camera with as many random masks, exactly as the attacker thinks that it is built.

    Masks are ``u ** exponent`` for uniform ``u``: sparse ones differ more from one another.
    """
    generator = torch.Generator().manual_seed(seed)
    drawn = StoredMasks.random(CAMERA, masks, generator)
    source = StoredMasks([weights**exponent for weights in drawn.weights])
    return Victim(decoding.operator, source, release, decoding=decoding, generator=generator)


def hits(read: Tensor, scenes: Tensor) -> int:
    """How many decoded scenes are most like their own of a gallery of ``GALLERY`` pictures.

    Args:
        read: (count, at least 64); the first 64 are the estimate.
        scenes: (count, 8, 8).
    """

    def shape(values: Tensor) -> Tensor:
        centred = values - values.mean(1, keepdim=True)
        unit: Tensor = centred / centred.norm(dim=1, keepdim=True).clamp_min(1e-12)
        return unit

    found = 0
    one, other = shape(read[:, : 8 * 8]), shape(scenes.flatten(1))
    for part in torch.split(torch.arange(len(scenes)), GALLERY):
        likeness = one[part] @ other[part].T
        found += int((likeness.argmax(1) == torch.arange(len(part))).sum())
    return found


def luck(count: int) -> int:
    """More hits than this come by chance less than once in ten thousand times."""
    return int(binom.isf(1e-4, count, 1 / GALLERY))


def most(count: int) -> int:
    """Hits of an attacker who reads nearly everything."""
    return math.floor(0.8 * count)
