"""Bundles whose masks show pictures of the scene are refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import pytest

from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_server.bundles.hiding import HidingCheck
from veilcam_server.bundles.loader import bundle_info
from veilcam_server.demo_data import BUNDLE, FRESH
from veilcam_server.errors import BundleRefusedError
from veilcam_training.bundle import Bundle, Hiding, read_bundle, write_bundle

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio
Levels = npt.NDArray[np.uint8]
SHAPE, TOP = Camera().mask_shape, 63


@pytest.fixture(scope="module")
def shipped() -> Bundle:
    return read_bundle(BUNDLE)


def holding(bundle: Bundle, *masks: Levels) -> Bundle:
    """The bundle with other masks, whatever its classifiers were trained for."""
    pair = bundle.pairs[0]
    pairs = tuple(dataclasses.replace(pair, levels=levels) for levels in masks)
    return dataclasses.replace(bundle, pairs=pairs)


def drawn(seed: int, top: int = TOP) -> Levels:
    return np.random.default_rng(seed).integers(0, top + 1, SHAPE).astype(np.uint8)


def with_holes(levels: Levels, count: int) -> Levels:
    random = np.random.default_rng(count)
    for _ in range(count):
        row, column = random.integers(SHAPE[0] - 2), random.integers(SHAPE[1])
        levels[row : row + 3, column] = TOP
    return levels


def ground(level: int) -> Levels:
    return np.full(SHAPE, level, np.uint8)


SHOWING = {
    "closed": ground(0),
    "open": ground(TOP),
    "half open": np.where(np.arange(SHAPE[0])[:, None] < 25, TOP, ground(0)).astype(np.uint8),
    "a hole": with_holes(ground(0), 1),
    "a hole in an even ground": with_holes(ground(20), 1),
    "a hole in a random ground": with_holes(drawn(1, 19), 1),
    "eight holes": with_holes(ground(0), 8),
    "thirty holes": with_holes(ground(0), 30),
}


@pytest.mark.parametrize("name", SHOWING)
def test_mask_that_shows_pictures_is_refused(shipped: Bundle, name: str) -> None:
    bundle = holding(shipped, drawn(2), SHOWING[name])
    with pytest.raises(BundleRefusedError, match=r"^mask 1 shows pictures of the scene") as caught:
        HidingCheck()(bundle)
    assert "\n" not in str(caught.value)
    HidingCheck(allow=True)(bundle)


def test_random_masks_are_taken(shipped: Bundle) -> None:
    HidingCheck()(holding(shipped, *(drawn(seed) for seed in range(3))))


def test_random_mask_is_taken_whatever_the_embedding(shipped: Bundle) -> None:
    HidingCheck()(dataclasses.replace(holding(shipped, drawn(5)), embedding=Embedding(3, 4)))


def test_rule_that_draws_nearly_open_masks_is_refused() -> None:
    bundle = read_bundle(FRESH)
    assert bundle.fresh is not None
    drawn = bundle.fresh.distribution
    lowest = np.full_like(drawn.lowest, 57)
    fresh = dataclasses.replace(
        bundle.fresh, distribution=dataclasses.replace(drawn, lowest=lowest)
    )
    with pytest.raises(BundleRefusedError, match=r"^mask 0 shows pictures of the scene"):
        HidingCheck()(dataclasses.replace(bundle, fresh=fresh))


def test_record_decides_for_its_own_masks_alone(shipped: Bundle) -> None:
    bundle = holding(shipped, drawn(3), drawn(4))
    record = Hiding(
        digest=bundle.masks_digest,
        masks=2,
        scenes=200,
        worst=1,
        seen=0.5,
        random_seen=0.03,
        pinhole_seen=1.0,
        recognised=1.0,
        random_recognised=1.0,
    )
    marked = dataclasses.replace(bundle, hiding=record)
    with pytest.raises(BundleRefusedError, match=r"^mask 1 shows pictures of the scene \(an eye"):
        HidingCheck()(marked)
    told = bundle_info(marked).hiding
    assert told is not None
    assert told.visible
    others = holding(marked, drawn(5), drawn(6))
    HidingCheck()(others)
    assert bundle_info(others).hiding is None


async def test_bundle_that_shows_pictures_is_not_taken_in(
    running: Running, bench: Bench, bundle: Bundle, tmp_path: Path
) -> None:
    path = tmp_path / "open.veilcam"
    pairs = tuple(
        dataclasses.replace(pair, levels=np.full_like(pair.levels, number))
        for number, pair in enumerate(bundle.pairs)
    )
    write_bundle(path, dataclasses.replace(bundle, pairs=pairs))
    async with running() as client:
        answer = await client.post(
            "/v1/bundles", content=path.read_bytes(), headers={"Content-Type": BUNDLE_MEDIA_TYPE}
        )
        assert (answer.status_code, answer.json()["code"]) == (422, "bundle_refused")
        assert "mask 0 shows pictures of the scene" in answer.json()["detail"]
    assert list((bench.state_dir / "bundles").iterdir()) == []
