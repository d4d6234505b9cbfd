"""Training images are moved by the amounts asked for, and shown where they are wanted."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from veilcam_optics.camera.geometry import Camera, Scene, Window
from veilcam_training.transforms.augment import Augmentation, augment
from veilcam_training.transforms.placement import Anywhere

CAMERA = Camera(window=Window(rows=18, columns=9))


@pytest.mark.parametrize("name", ["rotation", "scale", "shear", "shift"])
def test_augmentation_moves_by_the_amount_asked_for(name: str) -> None:
    none: dict[str, Any] = {"rotation": 0.0, "scale": 0.0, "shear": 0.0, "shift": 0.0}
    images = torch.zeros(50, 21, 21)
    images[:, 8:13, 5:16] = 1
    same = augment(images, Augmentation(**none), torch.Generator().manual_seed(0))
    assert torch.allclose(same, images, atol=1e-5)
    amounts = {"rotation": 20.0, "scale": 0.2, "shear": 0.3, "shift": 2.0}
    little, much = (
        augment(
            images,
            Augmentation(**{**none, name: share * amounts[name]}),
            torch.Generator().manual_seed(0),
        )
        for share in (0.3, 1.0)
    )
    changes = [float((moved - images).abs().mean()) for moved in (little, much)]
    assert 0 < changes[0] < changes[1]
    assert float(much.min()) >= 0
    assert float(much.max()) <= 1 + 1e-6


def test_augmentation_mirrors_half_of_the_images() -> None:
    images = torch.zeros(200, 9, 9)
    images[:, :, :3] = 1
    still = Augmentation(rotation=0, scale=0, shear=0, shift=0, mirror=True)
    moved = augment(images, still, torch.Generator().manual_seed(0))
    mirrored = (moved[:, 4, 8] > 0.5).float().mean()
    assert 0.35 < float(mirrored) < 0.65
    assert torch.allclose(moved.sum((1, 2)), images.sum((1, 2)), rtol=1e-4)


def test_placement_anywhere_covers_the_field_of_view() -> None:
    placement = Anywhere(Scene(), CAMERA, multiple=2)
    assert placement.scene.shape == (110, 146)
    pixel = placement.scene.pixel_at_sensor(CAMERA)
    assert pixel == pytest.approx(Scene().pixel_at_sensor(CAMERA))
    assert abs(110 * pixel - CAMERA.sensor.height) < pixel
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(500, 28, 28, generator=generator) + 0.1
    scenes = placement(images, generator)
    assert scenes.shape == (500, 110, 146)
    assert torch.allclose(scenes.sum((1, 2)), images.sum((1, 2)), rtol=1e-4)
    lit = scenes > 0
    tops = lit.any(2).float().argmax(1)
    lefts = lit.any(1).float().argmax(1)
    assert (int(tops.min()), int(tops.max())) == (0, 82)
    assert (int(lefts.min()), int(lefts.max())) == (0, 118)
    for scene, image, top, left in zip(scenes, images, tops, lefts, strict=True):
        assert torch.equal(scene[top : top + 28, left : left + 28], image)
    (shown,) = placement.in_parts(images, generator, training=True)
    assert shown.part is None
    assert len(shown.scenes) == 500
