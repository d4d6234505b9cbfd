"""Augmentation stays within its bounds and does each of its changes."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from veilcam_training.seeding import stream
from veilcam_training.transforms.augmentation import Augmentation, ShearedAugmentation


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


@pytest.mark.parametrize("name", ["rotation", "scale", "shear", "shift"])
def test_sheared_one_moves_by_the_amount_asked_for(name: str) -> None:
    none: dict[str, Any] = {"rotation": 0.0, "scale": 0.0, "shear": 0.0, "shift": 0.0}
    images = torch.zeros(50, 21, 21)
    images[:, 8:13, 5:16] = 1
    same = ShearedAugmentation(**none)(images, stream(0, "augmentation"))
    assert torch.allclose(same, images, atol=1e-5)
    amounts = {"rotation": 20.0, "scale": 0.2, "shear": 0.3, "shift": 2.0}
    little, much = (
        ShearedAugmentation(**{**none, name: share * amounts[name]})(
            images, stream(0, "augmentation")
        )
        for share in (0.3, 1.0)
    )
    changes = [float((moved - images).abs().mean()) for moved in (little, much)]
    assert 0 < changes[0] < changes[1]
    assert float(much.min()) >= 0
    assert float(much.max()) <= 1 + 1e-6


def test_sheared_one_mirrors_half_of_the_images() -> None:
    images = torch.zeros(200, 9, 9)
    images[:, :, :3] = 1
    still = ShearedAugmentation(rotation=0, scale=0, shear=0, shift=0, mirror=True)
    moved = still(images, stream(0, "augmentation"))
    mirrored = (moved[:, 4, 8] > 0.5).float().mean()
    assert 0.35 < float(mirrored) < 0.65
    assert torch.allclose(moved.sum((1, 2)), images.sum((1, 2)), rtol=1e-4)
