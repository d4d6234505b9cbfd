"""Masks are found where captures tell of them, and not where they are uniform directions."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from scipy.stats import binom
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.decoding import SceneDecoding, fit_statistics
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.attacks.mask_recovery import (
    Evidence,
    KnownPictures,
    MeanCapture,
    Search,
    estimates,
    recover_mask,
)
from veilcam_training.attacks.victim import StoredMasks, Victim, VictimMask, raw
from veilcam_training.errors import TrainingError

CAMERA = Camera(window=Window(rows=12, columns=6))
SCENE = Scene(rows=8, columns=8)
SEARCH = Search(steps=200, starts=1)
COUNT, GALLERY = 400, 20
"""Captures that are looked up with the mask that was found, in galleries of so many pictures."""
LUCK = int(binom.isf(1e-4, COUNT, 1 / GALLERY))
"""More hits than this come by chance less than once in ten thousand times."""


def pictures(count: int, seed: int) -> Tensor:
    """Two blobs each, anywhere, (count, 8, 8) in [0, 1]."""
    generator = torch.Generator().manual_seed(seed)
    middles = 7 * torch.rand(count, 2, 2, 1, 1, generator=generator)
    along, across = torch.arange(8.0)[:, None], torch.arange(8.0)[None]
    apart = (along - middles[:, :, 0]).square() + (across - middles[:, :, 1]).square()
    return torch.exp(-apart / 2).sum(1).clamp_max(1)


@pytest.fixture(scope="module")
def decoding() -> SceneDecoding:
    """What is public: the operator of a 6 x 8 embedding, and statistics of such pictures."""
    operator = TransferOperator(CAMERA, SCENE, Embedding(6, 8))
    return SceneDecoding(operator, fit_statistics([pictures(2000, seed=1)], rank=40))


def make_victim(decoding: SceneDecoding) -> Victim:
    """A camera with a random mask, exactly as the attacker thinks that it is built."""
    generator = torch.Generator().manual_seed(0)
    masks = StoredMasks.random(CAMERA, 1, generator)
    return Victim(decoding.operator, masks, raw, decoding=decoding, generator=generator)


def hits(read: Tensor, scenes: Tensor) -> int:
    """How many decoded scenes, (count, 8, 8), are most like their own of a gallery."""

    def shape(values: Tensor) -> Tensor:
        centred = values.flatten(1) - values.mean((1, 2))[:, None]
        unit: Tensor = centred / centred.norm(dim=1, keepdim=True).clamp_min(1e-12)
        return unit

    one, other = (shape(each).reshape(-1, GALLERY, 64) for each in (read, scenes))
    return int(((one @ other.mT).argmax(2) == torch.arange(GALLERY)).sum())


def read(decoding: SceneDecoding, evidence: Evidence, victim: Victim, mask: VictimMask) -> int:
    """Hits among captures of a mask, by the mask that the evidence gave away."""
    generator, shape = torch.Generator().manual_seed(5), CAMERA.mask_shape
    weights = recover_mask(evidence, shape, search=SEARCH, generator=generator).weights
    scenes = pictures(COUNT, seed=3)
    return hits(estimates(decoding, weights, victim.capture(mask, scenes)), scenes)


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_mask_is_given_away_by_raw_captures(decoding: SceneDecoding, *, known: bool) -> None:
    """By a few known pictures, or by the mean of many captures."""
    victim = make_victim(decoding)
    mask, shown = victim.mask(), pictures(4, seed=2) if known else pictures(1000, seed=4)
    released = victim.capture(mask, shown)
    found = read(
        decoding,
        KnownPictures(decoding, shown, released)
        if known
        else MeanCapture(decoding, released.mean(0), len(released)),
        victim,
        mask,
    )
    assert found > (0.8 * COUNT if known else 3 * LUCK)


@pytest.mark.slow
def test_search_takes_the_start_that_explains_most(decoding: SceneDecoding) -> None:
    victim = make_victim(decoding)
    mask, known = victim.mask(), pictures(2, seed=2)
    evidence = KnownPictures(decoding, known, victim.capture(mask, known))
    generator = torch.Generator().manual_seed(5)
    said: list[tuple[int, int]] = []
    search = partial(recover_mask, evidence, CAMERA.mask_shape)
    once = Search(steps=40, starts=1)
    losses = [search(search=once, generator=generator).loss for _ in range(3)]
    best = search(
        search=Search(steps=40, starts=3),
        generator=torch.Generator().manual_seed(5),
        progress=lambda done, total: said.append((done, total)),
    )
    assert best.loss == min(losses) < max(losses)
    assert said == [(1, 3), (2, 3), (3, 3)]
    with pytest.raises(TrainingError, match="without a step"):
        search(search=Search(starts=0), generator=generator)
