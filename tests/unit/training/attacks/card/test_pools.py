"""Pools: what is decoded with the right key, with a wrong one, and with a list."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest
import torch
from tests.unit.training.attacks.card.conftest import make_fresh, make_images, make_pairs

from veilcam_training.attacks.card.pools import PART, Pool, collect, draw
from veilcam_training.attacks.card.subject import make_subject
from veilcam_training.bundle import Bundle


def pool(
    bundle: Bundle, folder: Path | None = None, *, own: bool = False, form: str | None = None
) -> Pool:
    images = make_images()
    subject = make_subject(bundle, images.scenes(slice(0, 300)), form=form, seed=1)
    return collect(
        subject,
        images,
        masks=2 * PART,
        own=own,
        seed=1,
        folder=folder,
        progress=lambda *_: None,
    )


def error(found: Pool, name: str) -> float:
    truth = make_images().scenes(found.chosen.flatten()).reshape(found.right.shape)
    decoded: torch.Tensor = getattr(found, name)
    return float((decoded - truth).square().mean())


@pytest.mark.slow
@pytest.mark.parametrize("form", ["raw", "sealed"])
def test_of_fresh_masks_the_key_decodes_and_nothing_else(form: str) -> None:
    found = pool(make_fresh(), form=form)
    assert found.masks == 2 * PART
    # Neighbours saw the same.
    assert torch.equal(found.chosen[::2], found.chosen[1::2])
    assert not torch.equal(found.chosen[0], found.chosen[2])
    assert error(found, "right") < 0.5 * error(found, "wrong")
    assert error(found, "right") < 0.5 * error(found, "listed")
    assert found.scores.shape == (*found.labels.shape, 4)


@pytest.mark.slow
def test_list_of_stored_masks_has_the_right_one(tmp_path: Path) -> None:
    # Two masks: a wrong one is always the other, never by chance the same.
    found = pool(make_pairs(2), tmp_path)
    assert error(found, "listed") < 1.2 * error(found, "right")
    same = (found.wrong - found.right).abs().amax((1, 2, 3)) < 1e-3
    assert not same.any()
    again = pool(make_pairs(2), tmp_path)
    assert len(list(tmp_path.iterdir())) == 2
    for each in fields(Pool):
        assert torch.equal(getattr(found, each.name), getattr(again, each.name))
    # The seal has a key of its own for every epoch: a list of masks does not open it.
    closed = pool(make_pairs(2), form="sealed")
    assert error(closed, "listed") > 2 * error(closed, "right")


@pytest.mark.slow
def test_attacker_s_own_camera_has_other_masks_and_no_classifier() -> None:
    found = pool(make_pairs(2), own=True)
    assert found.scores.shape[-1] == 0
    assert error(found, "right") < 0.5 * error(found, "wrong")


def test_classes_have_equal_chances_whatever_their_shares_are() -> None:
    images = make_images()
    few, others = (images.labels == 0).nonzero()[:3], (images.labels > 0).nonzero()
    rare = images.take(torch.cat([few, others]).flatten())
    labels = rare.labels[draw(rare, 800, torch.Generator().manual_seed(1))]
    # 200 of 800, with a deviation of 12.2.
    assert abs(int((labels == 0).sum()) - 200) < 5 * 12.2
