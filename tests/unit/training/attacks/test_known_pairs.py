"""Known captures of a mask read its others, and tell nothing where every capture is turned anew."""

from __future__ import annotations

import pytest
import torch
from scipy.stats import binom
from torch import Tensor

from veilcam_training.attacks.known_pairs import (
    FewNetwork,
    KernelRidge,
    Mask,
    Neighbours,
    Reader,
    angles,
    by_anchors,
    hits,
    readers,
    tuned,
)
from veilcam_training.attacks.networks import Seen

PIXELS, CLASSES, KNOWN, ASKED = 24, 5, 60, 100
READERS: dict[str, Reader] = {
    "linear": KernelRidge("linear", 0.1),
    "quadratic": KernelRidge("quadratic", 0.1),
    "gaussian": KernelRidge("gaussian", 0.1),
    "laplace": KernelRidge("laplace", 0.1),
    "neighbours": Neighbours(5),
    "network": FewNetwork(0.01, epochs=10),
}


def random(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def pictures(count: int, seed: int) -> Seen:
    """Of classes that lie apart, though less than their members do."""
    labels = torch.arange(count) % CLASSES
    typical = 0.6 * random(CLASSES, PIXELS, seed=0)[labels]
    return Seen(typical + random(count, PIXELS, seed=seed), labels)


def captures(seen: Seen, seed: int) -> Seen:
    """What leaves behind the rotation of ``seed``."""
    vectors = seen.vectors @ torch.linalg.qr(random(PIXELS, PIXELS, seed=seed + 10**6))[0]
    return Seen(vectors / vectors.norm(dim=1, keepdim=True), seen.labels)


def masks(count: int, seed: int, *, anew: bool, known: int = KNOWN) -> list[Mask]:
    """Behind all of them the same pictures are known; ``anew``: others are directions alone."""
    found = []
    for each in range(1000 * seed, 1000 * seed + count):
        asked = pictures(ASKED, each)
        if anew:
            asked = Seen(random(ASKED, PIXELS, seed=each), asked.labels)
        found.append(Mask(captures(pictures(known, 1), each), captures(asked, each)))
    return found


def judge(reader: Reader, *, anew: bool, known: int = KNOWN) -> None:
    """It reads the captures of three masks, or no more than whoever guesses."""
    found = int(hits(reader, masks(3, 7, anew=anew, known=known), CLASSES).sum())
    chance = binom(3 * ASKED, 1 / CLASSES)
    # Sixteen bounds: all hold with a chance of 99.8 % where nothing is told.
    if anew:
        assert chance.isf(1 - 1e-4) <= found <= chance.isf(1e-4)
    else:
        assert found > chance.isf(1e-6)


@pytest.mark.parametrize(
    "reader",
    [pytest.param(each, marks=pytest.mark.slow) if each == "network" else each for each in READERS],
)
def test_reader_reads_behind_a_mask_of_which_it_knows_captures(reader: str) -> None:
    judge(READERS[reader], anew=False)
    judge(READERS[reader], anew=True)


@pytest.mark.thorough
@pytest.mark.parametrize("ridge", [float("inf"), 0.1])
def test_angles_to_known_pictures_say_more_than_their_classes(ridge: float) -> None:
    few = 6  # little more than one of each class
    for anew in (False, True):
        own, check = (masks(n, seed, anew=anew, known=few) for n, seed in ((20, 3), (2, 4)))
        reader = by_anchors(own, check, CLASSES, ridge=ridge, epochs=20)
        judge(reader, anew=anew, known=few)
        if not anew:
            test = masks(3, 7, anew=False, known=few)
            other = tuned(READERS, check, CLASSES)[1]
            assert hits(reader, test, CLASSES).sum() > hits(other, test, CLASSES).sum()


def test_angles_are_those_of_directions_and_a_known_one_stands_alone() -> None:
    known, others = random(5, PIXELS, seed=1), random(3, PIXELS, seed=2)
    apart = known - known.mean(0), others - known.mean(0)
    expected = torch.nn.functional.cosine_similarity(apart[1][:, None], apart[0][None], dim=2)
    torch.testing.assert_close(angles(known, others, float("inf")), expected)
    # Less their mean, five directions are in four dimensions: a small ridge keeps them solvable.
    alone = angles(known[:1], known[:1], 0.25)
    torch.testing.assert_close(alone, torch.tensor([[1 / 1.25]]))
    assert not torch.allclose(angles(known, others, 0.1), expected)


def test_settings_are_chosen_by_what_they_read() -> None:
    told: list[tuple[int, int]] = []

    def blind(known: Seen, vectors: Tensor, classes: int) -> Tensor:
        return torch.zeros(len(vectors), classes)

    check = masks(2, 5, anew=False)
    name, _ = tuned(
        {"blind": blind, "linear": READERS["linear"]},
        check,
        CLASSES,
        progress=lambda *each: told.append(each),
    )
    assert name == "linear"
    assert told == [(1, 2), (2, 2)]
    # Of less that is known less is read.
    less = [mask.of_first(2) for mask in check]
    assert [len(mask.known.labels) for mask in less] == [2, 2]
    found = [hits(READERS["linear"], each, CLASSES).sum() for each in (less, check)]
    assert found[0] < found[1]


def test_every_setting_of_a_reader_changes_its_scores() -> None:
    mask = masks(1, 6, anew=False)[0]
    scores = [each(mask.known, mask.asked.vectors, CLASSES) for each in readers().values()]
    for place, one in enumerate(scores):
        assert not any(torch.allclose(one, other) for other in scores[:place])
