"""Augmentation stays within its bounds and does each of its changes."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from veilcam_training.seeding import stream
from veilcam_training.transforms.augmentation import Augmentation


def spot(row: int, column: int, count: int = 3000) -> torch.Tensor:
    images = torch.zeros(count, 29, 29)
    images[:, row - 1 : row + 2, column - 1 : column + 2] = 1
    return images


def places(images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Centroids (y, x) from the middle."""
    at, light = torch.arange(29) - 14, images.sum((1, 2))
    return (images.sum(2) * at).sum(1) / light, (images.sum(1) * at).sum(1) / light


def test_augmentation_of_nothing_changes_nothing() -> None:
    assert not Augmentation().any
    images = torch.rand(4, 28, 20, generator=stream(0, "images"))
    torch.testing.assert_close(Augmentation()(images, stream(0, "jitter")), images)


def moved(row: int, column: int, **changes: Any) -> tuple[torch.Tensor, torch.Tensor]:
    return places(Augmentation(**changes)(spot(row, column), stream(0, "jitter")))


def test_each_change_stays_within_its_bounds() -> None:
    y, x = moved(14, 22, rotation=30.0)
    torch.testing.assert_close(y.hypot(x), torch.full_like(x, 8), rtol=0.02, atol=0)
    for values, low, high, error in (
        (torch.atan2(y, x).rad2deg(), -30, 30, 1),
        (moved(14, 22, scale=0.2)[1], 6.4, 9.6, 0.1),
        *((place, -2.9, 2.9, 0.05) for place in moved(14, 14, shift=0.1)),
    ):
        assert float(values.min()) == pytest.approx(low, abs=error)
        assert float(values.max()) == pytest.approx(high, abs=error)
    y, x = moved(10, 20, mirror=True)
    torch.testing.assert_close(y, torch.full_like(y, -4))
    torch.testing.assert_close(x.abs(), torch.full_like(x, 6))
    assert 0.45 < float((x < 0).float().mean()) < 0.55


def test_colours_move_together() -> None:
    gray = torch.rand(5, 12, 12, generator=stream(0, "images"))
    changes = Augmentation(rotation=20.0, scale=0.1, shift=0.1, mirror=True)
    expected = changes(gray, stream(0, "jitter"))
    colour = changes(gray[:, None].repeat(1, 3, 1, 1), stream(0, "jitter"))
    torch.testing.assert_close(colour, expected[:, None].expand(5, 3, 12, 12))


def test_crop_moves_by_whole_pixels() -> None:
    images = torch.rand(400, 3, 9, 11, generator=stream(0, "images"))
    moved = Augmentation(crop=2)(images, stream(0, "crop"))
    framed = torch.nn.functional.pad(images, (2,) * 4, "reflect")
    found = set()
    for image, frame in zip(moved, framed, strict=True):
        places = [(y, x) for y in range(5) for x in range(5)]
        found |= {p for p in places if torch.equal(image, frame[:, p[0] :, p[1] :][:, :9, :11])}
    assert len(found) == 25
    gray = Augmentation(crop=2)(images[:, 0], stream(0, "crop"))
    assert torch.equal(gray, moved[:, 0])
