"""Jitter stays within its bounds and does each of its changes."""

from __future__ import annotations

import pytest
import torch

from veilcam_training.seeding import stream
from veilcam_training.transforms.augmentation import Jitter, jitter


def spot(row: int, column: int, count: int = 3000) -> torch.Tensor:
    images = torch.zeros(count, 29, 29)
    images[:, row - 1 : row + 2, column - 1 : column + 2] = 1
    return images


def places(images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Centroids (y, x) from the middle."""
    at, light = torch.arange(29) - 14, images.sum((1, 2))
    return (images.sum(2) * at).sum(1) / light, (images.sum(1) * at).sum(1) / light


def test_nothing_is_nothing() -> None:
    assert not Jitter().any
    images = torch.rand(4, 28, 20, generator=stream(0, "images"))
    torch.testing.assert_close(jitter(images, Jitter(), stream(0, "jitter")), images)


def test_rotation() -> None:
    y, x = places(jitter(spot(14, 22), Jitter(rotation=30.0), stream(0, "jitter")))
    angles = torch.atan2(y, x).rad2deg()
    assert float(angles.min()) == pytest.approx(-30, abs=1)
    assert float(angles.max()) == pytest.approx(30, abs=1)
    torch.testing.assert_close(y.hypot(x), torch.full_like(x, 8), rtol=0.02, atol=0)


def test_scale() -> None:
    _, x = places(jitter(spot(14, 22), Jitter(scale=0.2), stream(0, "jitter")))
    assert float(x.min()) == pytest.approx(6.4, abs=0.1)
    assert float(x.max()) == pytest.approx(9.6, abs=0.1)


def test_shift() -> None:
    y, x = places(jitter(spot(14, 14), Jitter(shift=0.1), stream(0, "jitter")))
    for place in (y, x):
        assert float(place.min()) == pytest.approx(-2.9, abs=0.05)
        assert float(place.max()) == pytest.approx(2.9, abs=0.05)


def test_mirror() -> None:
    y, x = places(jitter(spot(10, 20), Jitter(mirror=True), stream(0, "jitter")))
    torch.testing.assert_close(y, torch.full_like(y, -4))
    torch.testing.assert_close(x.abs(), torch.full_like(x, 6))
    assert 0.45 < float((x < 0).float().mean()) < 0.55


def test_colours_move_together() -> None:
    gray = torch.rand(5, 12, 12, generator=stream(0, "images"))
    changes = Jitter(rotation=20.0, scale=0.1, shift=0.1, mirror=True)
    expected = jitter(gray, changes, stream(0, "jitter"))
    colour = jitter(gray[:, None].repeat(1, 3, 1, 1), changes, stream(0, "jitter"))
    torch.testing.assert_close(colour, expected[:, None].expand(5, 3, 12, 12))
