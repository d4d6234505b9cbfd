"""What is black costs nothing, and changes nothing."""

from __future__ import annotations

import pytest
import torch
from tests.unit.optics.tensors import seeded
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.regions import Region, embed_lit


def _digits(rows: int = 9, columns: int = 11) -> Tensor:
    scenes = torch.rand(5, rows, columns, generator=seeded(0))
    scenes[:, :2] = 0
    scenes[:, :, -3:] = 0
    scenes[:, 4, 4] = 0
    return scenes


def _transfer(asked: list[Region], matrix: Tensor, columns: int) -> Tensor:
    part = asked[-1]
    whole = matrix.reshape(-1, columns, matrix.shape[1])
    rows = slice(part.top, part.top + part.rows)
    return whole[rows, part.left : part.left + part.columns].reshape(-1, matrix.shape[1])


@pytest.mark.parametrize("shift", [(0, 0), (2, 3)])
def test_only_the_lit_part_is_asked_for(shift: tuple[int, int]) -> None:
    scenes = _digits()
    big = torch.zeros(5, 14, 16)
    big[:, shift[0] : shift[0] + 9, shift[1] : shift[1] + 11] = scenes
    matrix = torch.rand(14 * 16, 6, generator=seeded(1))
    asked: list[Region] = []

    def transfer(part: Region) -> Tensor:
        asked.append(part)
        return _transfer(asked, matrix, 16)

    found = embed_lit(scenes, Region(*shift, 9, 11), transfer)
    torch.testing.assert_close(found, big.flatten(1) @ matrix)
    assert asked == [Region(shift[0] + 2, shift[1], 7, 8)]


@pytest.mark.parametrize("scenes", [torch.ones(3, 9, 11), torch.zeros(3, 9, 11)])
def test_lit_or_dark_throughout_is_taken_whole(scenes: Tensor) -> None:
    matrix = torch.rand(99, 4)
    asked: list[Region] = []

    def transfer(part: Region) -> Tensor:
        asked.append(part)
        return matrix

    assert embed_lit(scenes, Region(0, 0, 9, 11), transfer).equal(scenes.flatten(1) @ matrix)
    assert asked == [Region(0, 0, 9, 11)]


def test_no_scenes_have_no_embeddings() -> None:
    found = embed_lit(torch.zeros(0, 3, 3), Region(0, 0, 3, 3), lambda _: torch.rand(9, 4))
    assert found.shape == (0, 4)


def test_light_may_be_negative() -> None:
    """Differences of scenes are embedded too."""
    matrix = torch.rand(99, 4)
    scenes = -_digits()
    found = embed_lit(scenes, Region(0, 0, 9, 11), lambda p: _transfer([p], matrix, 11))
    torch.testing.assert_close(found, scenes.flatten(1) @ matrix)


def test_gradients_reach_mask_and_black_pixels() -> None:
    scene, camera = Scene(rows=9, columns=11), Camera()
    operator = TransferOperator(camera, scene, Embedding(3, 4), dtype=torch.float64)
    scenes = _digits().double()
    pull = torch.rand(5, 3, 4, dtype=torch.float64)

    def gradient(embed: bool) -> Tensor:
        generator = seeded(2)
        weights = torch.rand(camera.mask_shape, generator=generator, dtype=torch.float64)
        weights.requires_grad_()
        if embed:
            values = operator.embed(scenes, weights)
        else:
            values = (scenes.flatten(1) @ operator(weights)).reshape(-1, 3, 4)
        (found,) = torch.autograd.grad((values * pull).sum(), weights)
        return found

    torch.testing.assert_close(gradient(embed=True), gradient(embed=False))
    asked = scenes.clone().requires_grad_()
    values = operator.embed(asked, torch.ones(camera.mask_shape, dtype=torch.float64))
    (found,) = torch.autograd.grad(values.sum(), asked)
    assert found.ne(0).all()
