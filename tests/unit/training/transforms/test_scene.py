"""Changes of the scene do what they say, and agree with each pixel worked out on its own."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.transfer.regions import Region
from veilcam_training.bundle.layers import Linear
from veilcam_training.encoders import Setup, make_encoder
from veilcam_training.errors import TrainingError
from veilcam_training.models.lensless import LenslessClassifier
from veilcam_training.seeding import stream
from veilcam_training.transforms.scene import (
    PLACES,
    TRANSFORMS,
    Anywhere,
    Identity,
    Perspective,
    Rescale,
    Rotate,
    Shift,
    make_transform,
)
from veilcam_training.transforms.warp import homographies, warp

IMAGE, CAMERA = Scene(), Camera()


def images(count: int = 6) -> Tensor:
    """Smooth blobs, the same from seed to seed, with one bright corner to tell sides apart."""
    noise = torch.rand(count, 1, 7, 7, generator=stream(0, "images"))
    smooth = torch.nn.functional.interpolate(noise, (28, 28), mode="bilinear")[:, 0]
    smooth[:, :6, :6] = 1
    return smooth


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("name", TRANSFORMS)
def test_contract(name: str, colour: bool) -> None:
    change = make_transform(name, IMAGE, CAMERA)
    pictures = images()[:, None].repeat(1, 3, 1, 1) if colour else images()
    scenes = change(pictures, stream(0, "change"))
    assert scenes.shape == (*pictures.shape[:-2], *change.scene.shape)
    assert float(scenes.min()) >= 0
    assert float(scenes.max()) <= 1 + 1e-5
    assert torch.equal(change(pictures, stream(0, "change")), scenes)
    assert torch.equal(change(pictures, stream(1, "change")), scenes) == (name == "none")
    if colour:
        gray = change(pictures[:, 0], stream(0, "change"))
        torch.testing.assert_close(scenes, gray[:, None].expand_as(scenes))
    # A scene pixel is as large as an image pixel, whatever the scene's extent.
    assert change.scene.pixel == pytest.approx(IMAGE.pixel)
    assert change.scene.distance == IMAGE.distance
    assert change(pictures[:0], stream(0, "change")).shape == (0, *scenes.shape[1:])


def test_shift_is_anywhere_wholly_on_the_sensor() -> None:
    change = Shift(IMAGE, CAMERA)
    assert change.scene.shape == (109, 146)
    assert change.scene.rows * IMAGE.pixel_at_sensor(CAMERA) <= CAMERA.sensor.height
    pictures = images(1).repeat(4000, 1, 1)
    scenes = change(pictures, stream(0, "change"))
    torch.testing.assert_close(scenes.sum((1, 2)), pictures.sum((1, 2)))
    for axis, room in ((2, 109 - 28), (1, 146 - 28)):
        firsts = (scenes.amax(axis) > 0).int().argmax(1)
        assert int(firsts.min()) == 0
        assert int(firsts.max()) == room
        assert float(firsts.float().mean()) == pytest.approx(room / 2, rel=0.05)
    top, left = ((scenes[0].amax(axis) > 0).int().argmax() for axis in (1, 0))
    torch.testing.assert_close(scenes[0, top : top + 28, left : left + 28], pictures[0])


def test_anywhere_covers_the_field_of_view() -> None:
    placement = Anywhere(IMAGE, CAMERA, multiple=2)
    assert placement.scene.shape == (110, 146)
    pixel = placement.scene.pixel_at_sensor(CAMERA)
    assert pixel == pytest.approx(IMAGE.pixel_at_sensor(CAMERA))
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
    centred = Identity(IMAGE)
    assert torch.equal(centred(images, generator), images)


@pytest.mark.parametrize("name", TRANSFORMS)
@pytest.mark.parametrize("count", [0, 1, 5, 40])
@pytest.mark.parametrize("training", [True, False])
def test_every_image_is_in_one_part(name: str, count: int, *, training: bool) -> None:
    change, pictures = make_transform(name, IMAGE, CAMERA), images(count)
    parts = list(change.in_parts(pictures, stream(0, "change"), training=training))
    chosen = torch.cat([shown.chosen for shown in parts])
    assert torch.equal(chosen.sort().values, torch.arange(count))
    for shown in parts:
        scene = (change.scene, *change.finer)[shown.grid]
        assert shown.scenes.shape[1:] == (scene.shape if shown.part is None else (28, 28))
    if name == "shift" and training:
        assert len({shown.part for shown in parts}) == max(1, min(count, PLACES))
        drawn = torch.cat([shown.scenes for shown in parts])
        torch.testing.assert_close(drawn, pictures)
    elif name == "rescale":
        assert len(parts) == len({shown.grid for shown in parts})
    else:
        (shown,) = parts
        assert torch.equal(shown.scenes, change(pictures, stream(0, "change")))


@pytest.mark.parametrize("encoder", ["learned", "fixed_simulated"])
def test_shifted_scenes_are_seen_alike_in_parts_and_whole(encoder: str) -> None:
    """What training takes for speed equals the definition, which evaluation takes."""
    change, pictures = Shift(IMAGE, CAMERA), images(20)
    camera = make_encoder(encoder, Setup(CAMERA, change.scene), stream(0, "encoder")).eval()
    whole = torch.zeros(20, *change.scene.shape)
    embeddings = []
    for shown in change.in_parts(pictures, stream(0, "change"), training=True):
        part = shown.part
        assert part is not None
        rows, columns = (slice(part.top, part.top + 28), slice(part.left, part.left + 28))
        whole[shown.chosen, rows, columns] = shown.scenes
        embeddings.append(camera(shown.scenes, part))
    torch.testing.assert_close(torch.cat(embeddings), camera(whole), rtol=1e-4, atol=1e-8)


def test_training_takes_few_places_and_evaluation_one_for_each_image() -> None:
    change, pictures = Shift(IMAGE, CAMERA), images(20)
    camera = make_encoder(
        "fixed_simulated", Setup(CAMERA, change.scene, Embedding(3, 4)), stream(0)
    )
    model = LenslessClassifier(camera, (Linear(inputs=12, outputs=10),), None, change=change)
    noise = stream(0, "noise")
    parts = change.in_parts(pictures, stream(0, "change"), training=True)
    seen = torch.cat([camera(shown.scenes, shown.part) for shown in parts])
    trained = model.train()(pictures, noise, stream(0, "change"))
    torch.testing.assert_close(trained, model.classifier(seen))
    seen = camera(change(pictures, stream(0, "change")))
    evaluated = model.eval()(pictures, noise, stream(0, "change"))
    torch.testing.assert_close(evaluated, model.classifier(seen))
    assert not torch.allclose(trained, evaluated)


def test_object_that_does_not_fit() -> None:
    with pytest.raises(TrainingError, match="does not fit the sensor's view"):
        Shift(Scene(height=0.6), CAMERA)
    with pytest.raises(TrainingError, match="use one of none, shift"):
        make_transform("twist", IMAGE, CAMERA)


@pytest.mark.parametrize("height", [0.02, 0.03, 0.055, 0.09, 0.12, 0.17, 0.20])
def test_rescale_keeps_the_light_per_area(height: float) -> None:
    change = Rescale(IMAGE, (height, height))
    scene = change(images(), stream(0, "change"))
    factor = height / IMAGE.height
    assert change.scene.rows == math.ceil(28 * factor - 1e-6)
    light = scene.sum((1, 2)) / images().sum((1, 2))
    torch.testing.assert_close(light, torch.full_like(light, factor**2), rtol=0.04, atol=0)


def test_rescaled_objects_are_on_the_finest_grid_with_room_for_them() -> None:
    change = Rescale(IMAGE)
    assert [grid.pixel for grid in change.finer] == pytest.approx([0.12 / 56, 0.12 / 112])
    white = torch.ones(2000, 28, 28)
    # Every height between its bounds is drawn.
    assert change.scene.shape == (47, 47)
    sides = change(white, stream(0, "change")).sum((1, 2)).sqrt() * IMAGE.pixel
    assert float(sides.min()) == pytest.approx(0.02, abs=0.002)
    assert float(sides.max()) == pytest.approx(0.20, abs=0.002)
    assert float(sides.mean()) == pytest.approx(0.11, rel=0.03)
    heights = {}
    for shown in change.in_parts(white, stream(0, "change"), training=False):
        pixel = (change.scene, *change.finer)[shown.grid].pixel
        heights[shown.grid] = shown.scenes.sum((1, 2)).sqrt() * pixel
        rows = (shown.scenes.sum(2) > 0).sum(1)
        assert int(rows.max()) <= 47
    for grid, (low, high) in enumerate([(0.1, 0.2), (0.05, 0.1), (0.02, 0.05)]):
        assert float(heights[grid].min()) == pytest.approx(low, abs=0.002)
        assert float(heights[grid].max()) == pytest.approx(high, abs=0.002)


@pytest.mark.parametrize("encoder", ["learned", "fixed_simulated", "lens", "digital"])
def test_finer_grid_shows_the_same_object(encoder: str) -> None:
    """A blurred blob, as large on either grid: its embedding hardly depends on its pixels."""
    change = Rescale(IMAGE)
    setup = Setup(CAMERA, change.scene, Embedding(6, 8), finer=change.finer)
    camera = make_encoder(encoder, setup, stream(0, "encoder")).eval()
    place = torch.arange(47) - 23.0
    seen = []
    for grid, scene in enumerate(setup.grids[:2]):
        distance = (place[:, None] ** 2 + place**2).sqrt() * scene.pixel
        seen.append(camera(torch.exp(-((distance / 0.012) ** 2))[None], None, grid))
    error = (seen[1] - seen[0]).detach().norm() / seen[0].detach().norm()
    assert float(error) < (0.2 if encoder == "digital" else 0.02)
    part = Region(10, 12, 5, 6)
    rows = camera.transfer(part, 1)
    whole = camera.transfer(None, 1).reshape(47, 47, -1)
    torch.testing.assert_close(rows, whole[10:15, 12:18].reshape(30, -1), rtol=1e-4, atol=1e-9)


def test_embeddings_are_in_the_order_of_the_images() -> None:
    change, pictures = Rescale(IMAGE), images(20)
    setup = Setup(CAMERA, change.scene, Embedding(3, 4), finer=change.finer)
    camera = make_encoder("fixed_simulated", setup, stream(0))
    model = LenslessClassifier(camera, (Linear(inputs=12, outputs=10),), None, change=change)
    together = model.embed(pictures, stream(0, "change"))
    for shown in change.in_parts(pictures, stream(0, "change"), training=False):
        seen = camera(shown.scenes, None, shown.grid)
        torch.testing.assert_close(together[shown.chosen], seen)


def test_rotation_is_up_to_the_angle_to_either_side() -> None:
    bar = torch.zeros(2000, 28, 28)
    bar[:, 13:15, 18:24] = 1  # to the right of the centre
    turned = Rotate(IMAGE)(bar, stream(0, "change"))
    place = torch.arange(28) - 13.5
    y = (turned.sum(2) * place).sum(1) / turned.sum((1, 2))
    x = (turned.sum(1) * place).sum(1) / turned.sum((1, 2))
    angles = torch.atan2(y, x).rad2deg()
    assert float(angles.min()) == pytest.approx(-90, abs=1)
    assert float(angles.max()) == pytest.approx(90, abs=1)
    assert abs(float(angles.mean())) < 4


def test_perspective_moves_corners_inwards() -> None:
    white = torch.ones(2000, 28, 28)
    scenes = Perspective(IMAGE)(white, stream(0, "change"))
    # Each corner moves by 0 to a quarter of the side along each axis, an eighth on average.
    share = scenes.mean((1, 2))
    assert 0.25 < float(share.min()) < 0.5
    assert 0.8 < float(share.max()) <= 1
    assert float(share.mean()) == pytest.approx(0.75**2, rel=0.03)
    torch.testing.assert_close(
        Perspective(IMAGE, 0.0)(images(), stream(0, "change")), images(), atol=1e-5, rtol=0
    )


def read_one_by_one(image: Tensor, corners: Tensor, ends: Tensor) -> Tensor:
    """Each pixel on its own: the map from corners to ends by a null space, four pixels by hand."""
    equations = []
    for (x, y), (u, v) in zip(corners.tolist(), ends.tolist(), strict=True):
        equations.append([x, y, 1, 0, 0, 0, -u * x, -u * y, -u])
        equations.append([0, 0, 0, x, y, 1, -v * x, -v * y, -v])
    solution = torch.linalg.svd(torch.tensor(equations, dtype=torch.float64)).Vh[-1].reshape(3, 3)
    padded = torch.nn.functional.pad(image.double(), (1, 1, 1, 1))
    result = torch.zeros_like(image)
    for row in range(28):
        for column in range(28):
            place = torch.tensor([column - 13.5, row - 13.5, 1.0], dtype=torch.float64)
            u, v, scale = (solution @ place).tolist()
            left, top = u / scale + 14.5, v / scale + 14.5  # of the padded picture
            if not (0 <= left < 29 and 0 <= top < 29):
                continue
            j, i = int(left), int(top)
            across = torch.tensor([1 - (left - j), left - j], dtype=torch.float64)
            down = torch.tensor([1 - (top - i), top - i], dtype=torch.float64)
            result[row, column] = down @ padded[i : i + 2, j : j + 2] @ across
    return result


@pytest.mark.parametrize("perspective", [0.0, 0.3])
def test_warp_is_that_of_each_pixel_on_its_own(perspective: float) -> None:
    """Corners turned and moved inwards; warp works in float32, whence the tolerance."""
    ends = 14 * torch.tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    inwards = 1 - perspective * torch.rand(3, 4, 2, generator=stream(0, "corners"))
    angles = torch.tensor([0.3, -1.2, 2.0])
    turns = torch.stack([angles.cos(), angles.sin(), -angles.sin(), angles.cos()], 1)
    corners = (ends * inwards) @ turns.reshape(3, 2, 2)
    warped = warp(images(3), homographies(corners, ends), (28, 28))
    for image, own, got in zip(images(3), corners, warped, strict=True):
        torch.testing.assert_close(got, read_one_by_one(image, own, ends), atol=1e-4, rtol=0)
