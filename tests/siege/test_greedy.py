"""What the greedy have: counted behind each mask, whatever its epochs are called."""

from __future__ import annotations

import json

import pytest
from tests.siege.client import Reply
from tests.siege.greedy import Loot


def reply(epoch: str, *values: float) -> Reply:
    embedding = {"form": "raw", "shape": [len(values)], "values": values}
    taken = {"id": "1", "epoch": epoch, "number": 0, "taken_at": "2026-01-02T03:04:05Z"}
    return Reply(200, json.dumps({**taken, "label": "1", "embedding": embedding}).encode())


@pytest.fixture
def loot() -> Loot:
    return Loot()


def test_nothing_is_nothing(loot: Loot) -> None:
    loot.take(Reply(0))
    loot.take(Reply(409, b'{"code": "leased"}'))
    assert (loot.most, loot.spent, loot.masks) == (0, 0, {})


def test_one_mask_in_two_epochs_is_one(loot: Loot) -> None:
    for epoch in ("a", "b"):
        loot.take(reply(epoch, 0.125, 0.25))
    loot.take(reply("c", 0.125, 0.375))
    assert (loot.most, len(loot.masks), loot.epochs.total()) == (2, 2, 3)


def test_two_embeddings_in_one_epoch_are_behind_one_mask(loot: Loot) -> None:
    """Whatever they hold: the scene may have changed."""
    for value in (0.125, 0.25, 0.375):
        loot.take(reply("a", value))
    assert loot.most == 3


def test_that_all_masks_are_spent_is_counted(loot: Loot) -> None:
    loot.take(Reply(409, b'{"code": "masks_spent"}'))
    assert loot.spent == 1
