"""Bundles whose masks hide nothing are refused, and those that training makes are not."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import pytest

from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_server.bundles.hiding import LEAST, HidingCheck
from veilcam_server.demo_data import BUNDLE, FRESH
from veilcam_server.errors import BundleRevealsError
from veilcam_training.bundle import Bundle, read_bundle, write_bundle

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio
Levels = npt.NDArray[np.uint8]
SHAPE, TOP = Camera().mask_shape, 63


@pytest.fixture(scope="module")
def shipped() -> Bundle:
    return read_bundle(BUNDLE)


@pytest.fixture(scope="module")
def check(shipped: Bundle) -> HidingCheck:
    return HidingCheck(shipped)


def holding(bundle: Bundle, *masks: Levels) -> Bundle:
    """The bundle with other masks, whatever its classifiers were trained for."""
    pairs = tuple(
        dataclasses.replace(pair, levels=levels)
        for pair, levels in zip(bundle.pairs, masks, strict=False)
    )
    return dataclasses.replace(bundle, pairs=pairs)


def closed(ground: int = 0) -> Levels:
    return np.full(SHAPE, ground, np.uint8)


def hole(levels: Levels, row: int, column: int) -> Levels:
    """One open pixel, a sub-pixel of each colour."""
    levels[row : row + 3, column] = TOP
    return levels


def nearly_open(least: int) -> Levels:
    return np.random.default_rng(1).integers(least, TOP + 1, SHAPE).astype(np.uint8)


HIDE_NOTHING = {
    "closed": closed(),
    "open": closed(TOP),
    "half transparent": closed(32),
    "one sub-pixel closed": np.where(np.arange(SHAPE[0] * SHAPE[1]) == 99, 0, TOP)
    .reshape(SHAPE)
    .astype(np.uint8),
    "open but for a few levels": nearly_open(57),
    "half open": np.where(np.arange(SHAPE[0])[:, None] < 25, TOP, closed()).astype(np.uint8),
    "from dark to open": np.repeat(
        np.linspace(0, TOP, SHAPE[0]).astype(np.uint8)[:, None], SHAPE[1], 1
    ),
    "a pinhole": hole(closed(), 24, 10),
    "a pinhole in a dim ground": hole(closed(3), 24, 10),
    "a pinhole in a dim random ground": hole(nearly_open(0) // 21, 24, 10),
    "two holes": hole(hole(closed(), 12, 4), 36, 17),
    "three holes": hole(hole(hole(closed(), 6, 3), 40, 18), 15, 15),
}


@pytest.mark.parametrize("name", HIDE_NOTHING)
def test_mask_that_hides_nothing_is_refused(shipped: Bundle, check: HidingCheck, name: str) -> None:
    with pytest.raises(
        BundleRevealsError, match=r"^mask 0 hides nothing \(\w+: 0\.\d\d of a random mask's, "
    ) as caught:
        check(holding(shipped, HIDE_NOTHING[name]))
    assert "\n" not in str(caught.value)
    # One among good ones is found, too.
    masks = (*(pair.levels for pair in shipped.pairs[:2]), HIDE_NOTHING[name])
    with pytest.raises(BundleRevealsError, match=r"^mask 2 hides nothing"):
        check(holding(shipped, *masks))


@pytest.mark.parametrize("path", [BUNDLE, FRESH], ids=["pairs", "fresh"])
def test_bundles_that_come_along_hide(path: Path) -> None:
    bundle = read_bundle(path)
    HidingCheck(bundle)(bundle)


@pytest.mark.parametrize("embedding", [Embedding(3, 4), Embedding(24, 32)])
@pytest.mark.parametrize("exponent", [1.0, 4.0, 10.0])
def test_masks_that_a_key_draws_hide_whatever_the_embedding(
    embedding: Embedding, exponent: float
) -> None:
    bundle = read_bundle(FRESH)
    assert bundle.fresh is not None
    drawn = MaskDistribution.power(bundle.camera, exponent)
    fresh = dataclasses.replace(bundle.fresh, distribution=drawn)
    bundle = dataclasses.replace(bundle, fresh=fresh, embedding=embedding)
    HidingCheck(bundle)(bundle)


def test_rule_that_draws_masks_which_hide_nothing_is_refused() -> None:
    bundle = read_bundle(FRESH)
    assert bundle.fresh is not None
    uniform = MaskDistribution.uniform(bundle.camera)
    for lowest in (57, 60):
        # 6 and 4 levels for each of 1,122 sub-pixels: far more than 128 bits.
        drawn = dataclasses.replace(uniform, lowest=np.full_like(uniform.lowest, lowest))
        assert drawn.bits > 2000
        fresh = dataclasses.replace(bundle.fresh, distribution=drawn)
        with pytest.raises(
            BundleRevealsError, match=r"^mask 0 hides nothing \((directions|own): 0"
        ):
            HidingCheck(bundle)(dataclasses.replace(bundle, fresh=fresh))


def test_floors_are_those_of_the_documents() -> None:
    text = (Path(__file__).resolve().parents[4] / "docs" / "bundle.md").read_text()
    for name, least in dataclasses.asdict(LEAST).items():
        assert re.search(rf"(?m)^\| `{name}` \| .* \| {least:g} \|$", text), name


async def test_bundle_that_hides_nothing_is_not_taken_in(
    running: Running, bench: Bench, bundle: Bundle, tmp_path: Path
) -> None:
    path = tmp_path / "open.veilcam"
    pairs = tuple(
        dataclasses.replace(pair, levels=np.full_like(pair.levels, 63 - number))
        for number, pair in enumerate(bundle.pairs)
    )
    write_bundle(path, dataclasses.replace(bundle, pairs=pairs))
    async with running() as client:
        answer = await client.post(
            "/v1/bundles", content=path.read_bytes(), headers={"Content-Type": BUNDLE_MEDIA_TYPE}
        )
        assert (answer.status_code, answer.json()["code"]) == (422, "bundle_reveals")
        assert "mask 0 hides nothing" in answer.json()["detail"]
    assert list((bench.state_dir / "bundles").iterdir()) == []
