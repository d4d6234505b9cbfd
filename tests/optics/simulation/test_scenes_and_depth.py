"""Where objects are in the scene, and scenes of several depths."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Sensor, Window
from veilcam_optics.errors import OpticsError
from veilcam_optics.simulation.depth import LayeredLight, scene_at, split_depth
from veilcam_optics.simulation.scenes import SceneTransform
from veilcam_optics.transfer.grid import GridLight

CANVAS = Scene(40, 50, height=0.4, distance=0.4)
BASE = SceneTransform(CANVAS, object_height=(0.2, 0.2))


def images(count: int = 3, *, side: int = 20) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.rand(count, side, side, generator=generator, dtype=torch.float64)


def centre(scene: Tensor) -> tuple[float, float]:
    rows, columns = (torch.arange(n, dtype=torch.float64) - (n - 1) / 2 for n in scene.shape)
    total = scene.sum()
    return float((scene.sum(1) * rows).sum() / total), float((scene.sum(0) * columns).sum() / total)


def test_without_change_the_picture_lies_in_the_middle() -> None:
    """20 pixels of 1 cm on a canvas of 1 cm pixels: a copy."""
    pictures = images()
    exact = dataclasses.replace(BASE, supersampling=1)(pictures, [0, 1, 2])
    assert exact.shape == (3, 40, 50)
    assert torch.allclose(exact[:, 10:30, 15:35], pictures, atol=1e-9)
    exact[:, 10:30, 15:35] = 0
    assert float(exact.abs().max()) == 0


@pytest.mark.parametrize("height", [0.02, 0.05, 0.2, 0.37])
def test_rescaling_keeps_brightness_and_takes_the_area(height: float) -> None:
    white = torch.ones(1, 28, 28, dtype=torch.float64)
    scaled = dataclasses.replace(BASE, object_height=(height, height), supersampling=8)
    drawn = scaled(white, [0])[0]
    # Bilinear reading fades the outer half pixel of the picture.
    area = (height / 0.01) ** 2
    assert float(drawn.sum()) == pytest.approx(area, rel=0.05)
    assert float(drawn.max()) <= 1 + 1e-12


def test_rotation_by_a_right_angle_is_a_rotation_of_the_array() -> None:
    pictures = images()
    turned = dataclasses.replace(BASE, rotation=(90.0, 90.0), supersampling=1)
    got = turned(pictures, [0, 1, 2])[:, 10:30, 15:35]
    ways = [pictures.rot90(times, (1, 2)) for times in (1, 3)]
    assert any(torch.allclose(got, way, atol=1e-9) for way in ways)


def test_shift_stays_inside_and_covers_the_canvas() -> None:
    shifted = dataclasses.replace(BASE, shift=True)
    white = torch.ones(1, 20, 20, dtype=torch.float64)
    full = float(BASE(white, [0]).sum())
    places = []
    for index in range(60):
        drawn = shifted(white, [index])[0]
        assert float(drawn.sum()) == pytest.approx(full, rel=0.01)  # nothing is cut off
        places.append(centre(drawn))
    y, x = torch.tensor(places).unbind(1)
    # Room for the middle: 40 - 20 rows and 50 - 20 columns.
    assert float(y.max()) == pytest.approx(10, abs=1.5)
    assert float(y.min()) == pytest.approx(-10, abs=1.5)
    assert float(x.max()) == pytest.approx(15, abs=2)
    assert float(x.min()) == pytest.approx(-15, abs=2)


def test_shift_takes_rotation_and_perspective_into_account() -> None:
    moved = dataclasses.replace(
        BASE, object_height=(0.2, 0.27), shift=True, rotation=(-90.0, 90.0), perspective=0.5
    )
    half = torch.tensor([0.2, 0.25], dtype=torch.float64)
    for index in range(50):
        assert bool((moved.corners(index).abs() <= half + 1e-12).all())


def test_perspective_moves_corners_inwards_and_keeps_lines_straight() -> None:
    seen = dataclasses.replace(BASE, perspective=0.5)
    square = torch.tensor([[-1, -1], [-1, 1], [1, 1], [1, -1]], dtype=torch.float64) * 0.1
    corners = seen.corners(3)
    assert not torch.allclose(corners, square)
    assert bool((corners.abs() <= 0.1).all())
    assert bool((corners.abs() >= 0.05 - 1e-12).all())
    # The picture's middle maps to where the diagonals of the corners cross.
    dot = torch.zeros(1, 21, 21, dtype=torch.float64)
    dot[0, 10, 10] = 1
    drawn = dataclasses.replace(seen, supersampling=8)(dot, [3])[0]
    a, b, c, d = corners
    lines = torch.stack([c - a, -(d - b)], dim=1)
    along = torch.linalg.solve(lines, b - a)
    crossing = (a + along[0] * (c - a)) / 0.01
    assert centre(drawn) == pytest.approx(crossing.tolist(), abs=0.15)


def test_the_draw_depends_on_seed_and_image_alone() -> None:
    changed = dataclasses.replace(BASE, shift=True, rotation=(-45.0, 45.0), perspective=0.3)
    pictures = images(4)
    whole = changed(pictures, [7, 8, 9, 10])
    alone = changed(pictures[2:3], [9])
    assert torch.allclose(whole[2], alone[0], atol=1e-12)
    assert torch.equal(changed(pictures, [7, 8, 9, 10]), whole)
    other = dataclasses.replace(changed, seed=1)(pictures, [7, 8, 9, 10])
    assert not torch.allclose(other, whole)
    assert not torch.allclose(changed(pictures[:1].expand(2, 20, 20), [0, 1])[0], whole[0])


def test_colour_and_empty_batches() -> None:
    pictures = images(6).reshape(2, 3, 20, 20)
    colour = BASE(pictures, [0, 1])
    assert colour.shape == (2, 3, 40, 50)
    assert torch.allclose(colour[:, 1], BASE(pictures[:, 1], [0, 1]))
    assert BASE(images(1)[:0], []).shape == (0, 40, 50)
    assert BASE(images().float(), [0, 1, 2]).dtype == torch.float32


def test_gradient_reaches_the_picture() -> None:
    changed = dataclasses.replace(BASE, rotation=(30.0, 30.0), perspective=0.3)
    small = images(1, side=4).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: changed(x, [5])[:, 15:25, 20:30], (small,))


def test_impossible_transforms_are_refused() -> None:
    changes: list[tuple[dict[str, Any], str]] = [
        ({"object_height": (0.0, 0.1)}, "object_height"),
        ({"object_height": (0.2, 0.1)}, "object_height"),
        ({"rotation": (10.0, -10.0)}, "rotation"),
        ({"rotation": (math.nan, 0.0)}, "rotation"),
        ({"perspective": 1.0}, "perspective"),
        ({"supersampling": 0}, "supersampling"),
    ]
    for change, name in changes:
        with pytest.raises(OpticsError, match=name):
            dataclasses.replace(BASE, **change)
    with pytest.raises(OpticsError, match="does not fit the canvas"):
        dataclasses.replace(BASE, object_height=(0.5, 0.5), shift=True)(images(1), [0])
    with pytest.raises(OpticsError, match="one per image"):
        BASE(images(), [0])
    with pytest.raises(OpticsError, match="images"):
        BASE(images().to(torch.int32), [0, 1, 2])


CAMERA = Camera(window=Window(12, 5, 180, 74), sensor=Sensor(640, 800), distance=4e-3)
SCENE = Scene(6, 8, 0.06, 0.4)
EMBEDDING = Embedding(5, 6)


def weights() -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.rand(CAMERA.mask_shape, generator=generator, dtype=torch.float64)


def test_layers_sum_to_the_picture_and_follow_the_depth() -> None:
    picture = images(2, side=6)
    depth = torch.linspace(0.2, 1.0, 36, dtype=torch.float64).reshape(6, 6)
    layers = split_depth(picture, depth, [0.3, 0.4, 0.8])
    assert layers.shape == (2, 3, 6, 6)
    assert torch.allclose(layers.sum(-3), picture)
    assert bool((layers >= 0).all())
    # Five pixels are nearer than the first layer: all of their light is in it.
    assert bool((depth[0, :5] < 0.3).all())
    assert bool((layers[:, 1:, 0, :5] == 0).all())
    at = split_depth(picture, torch.full((6, 6), 0.4), [0.3, 0.4, 0.8])
    assert torch.allclose(at[:, 1], picture)
    # Half way in curvature, not in distance.
    between = split_depth(picture, torch.tensor(2 / (1 / 0.4 + 1 / 0.8)).expand(6, 6), [0.4, 0.8])
    assert torch.allclose(between[:, 0], picture / 2)


def test_one_layer_is_a_flat_scene() -> None:
    picture = torch.rand(6, 8, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    layered = LayeredLight(CAMERA, SCENE, [0.4], oversampling=1)
    got = layered.embed(picture[None], layered.psf(weights()), EMBEDDING)
    flat = GridLight(CAMERA, SCENE, oversampling=1)
    assert torch.allclose(got, flat.embed(picture, flat.psf(weights()), EMBEDDING), rtol=1e-12)


def test_depth_changes_the_embedding_and_layers_add_up() -> None:
    picture = torch.rand(6, 8, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    # The shadow grows by 1 + 4 mm / distance: 5 % and 1 %.
    layered = LayeredLight(CAMERA, SCENE, [0.08, 0.4], oversampling=1)
    psfs = layered.psf(weights())
    dark = torch.zeros_like(picture)
    near = layered.embed(torch.stack([picture, dark]), psfs, EMBEDDING)
    far = layered.embed(torch.stack([dark, picture]), psfs, EMBEDDING)
    both = layered.embed(torch.stack([picture, picture]), psfs, EMBEDDING)
    assert torch.allclose(both, near + far, rtol=1e-12)
    assert float((near - far).norm() / far.norm()) > 0.02
    assert scene_at(SCENE, 0.8).pixel_at_sensor(CAMERA) == pytest.approx(
        SCENE.pixel_at_sensor(CAMERA)
    )


def test_impossible_depths_are_refused() -> None:
    picture = images(1, side=6)
    for distances in ([], [0.4, 0.3], [0.4, 0.4], [-1.0]):
        with pytest.raises(OpticsError, match="distances"):
            split_depth(picture, torch.ones(6, 6), distances)
    with pytest.raises(OpticsError, match="depth holds"):
        split_depth(picture, torch.zeros(6, 6), [0.3])
    layered = LayeredLight(CAMERA, SCENE, [0.4], oversampling=0.5)
    with pytest.raises(OpticsError, match="layers"):
        layered.embed(torch.zeros(2, 6, 8), layered.psf(weights()), EMBEDDING)
    with pytest.raises(OpticsError, match="distance"):
        scene_at(SCENE, 0.0)
