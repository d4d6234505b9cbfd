"""Scenes one after the other, and what is held up before them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.unit.server.devices.clock import Clock

from veilcam_optics.pictures import PictureError
from veilcam_server.devices.simulated.scenes import Scenes, StillScene


def scenes(*levels: float) -> tuple[Scenes, Clock]:
    clock = Clock()
    deck = [StillScene(np.full((2, 3), level), (2, 3)) for level in levels]
    return Scenes(deck, clock=clock), clock


def now(held: Scenes) -> tuple[int, float]:
    level = float(held.read().mean())
    return held.seen, round(level, 6)


def test_deck_turns_and_begins_again() -> None:
    deck, _ = scenes(0.1, 0.2, 0.3)
    seen = []
    for _ in range(4):
        seen.append(now(deck))
        deck.advance()
    assert seen == [(0, 0.1), (1, 0.2), (2, 0.3), (0, 0.1)]
    alone, _ = scenes(0.5)
    alone.advance()
    assert now(alone) == (0, 0.5)


def test_scene_held_up_covers_the_deck_which_rests() -> None:
    deck, _ = scenes(0.1, 0.2)
    deck.advance()
    assert deck.hold(torch.ones(4, 6)) == 2
    deck.advance()
    assert now(deck) == (2, 1.0)
    assert deck.hold(np.zeros((2, 3, 3), np.uint8)) == 3
    assert now(deck) == (3, 0.0)
    assert deck.hold(None) == 1
    assert now(deck) == (1, 0.2)
    deck.advance()
    assert now(deck) == (0, 0.1)


def test_each_instant_has_its_scene() -> None:
    deck, clock = scenes(0.1)
    began = clock()
    clock.sleep(1.0)
    deck.hold(np.ones((2, 3)))
    assert deck.at(began).mean() == pytest.approx(0.1)
    assert deck.seen == 0
    assert deck.at(clock()).mean() == 1
    assert deck.seen == 1


def test_scene_that_cannot_be_held_up_changes_nothing() -> None:
    deck, _ = scenes(0.1)
    with pytest.raises(PictureError, match="has the shape"):
        deck.hold(np.ones(3))
    assert now(deck) == (0, 0.1)
    with pytest.raises(ValueError, match="use one scene or more"):
        Scenes(())


def test_picture_held_up_in_colour_keeps_it() -> None:
    deck = Scenes([StillScene(np.full((2, 4), 0.5), (3, 2, 4))])
    assert deck.read() == pytest.approx(np.full((3, 2, 4), 0.5))
    deck.hold(np.full((4, 8, 3), (0, 51, 255), np.uint8))
    assert deck.read().mean((1, 2)) == pytest.approx([0, 0.2, 1])
