"""Parts of the demonstration: observers, tally and pictures."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from veilcam_client.keys.envelopes import seal_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.sealing import example_envelope
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.grid import GridLight
from veilcam_server.demo.observer import KeyObserver, PairObserver
from veilcam_server.demo.report import draw_block, draw_mask
from veilcam_server.demo.tally import EPOCHS_SHOWN, Sample, Tally
from veilcam_server.demo_data import load_digits
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.sealing.identity import DeviceKey

if TYPE_CHECKING:
    from veilcam_training.bundle import Bundle


@pytest.mark.slow
@pytest.mark.numerical
def test_observer_knows_every_mask(bundle: Bundle) -> None:
    light = GridLight(bundle.camera, bundle.scene, oversampling=2, dtype=torch.float32)
    observer, digits = PairObserver(bundle), load_digits()
    generator = torch.Generator().manual_seed(0)
    for index, pair in enumerate(bundle.pairs):
        psf = light.psf(torch.from_numpy(to_weights(pair.levels, bundle.camera.panel)))
        for image in digits.images[:5]:
            scene = torch.from_numpy(image / np.float32(255))
            seen = shot_noise(light.embed(scene, psf, bundle.embedding)[None], 40.0, generator)
            assert observer.which(image, seen[0].numpy(), example_envelope()) == index


@pytest.mark.numerical
def test_observer_with_a_key_draws_the_mask_of_an_envelope(
    fresh_bundle: Bundle,
) -> None:
    receiver, bundle = ReceiverKey.generate(), "0f" * 32
    signer = DeviceKey(Ed25519PrivateKey.generate())
    keys = [EpochKey.generate(device=signer.public, bundle=bundle) for _ in range(3)]
    envelopes = [
        seal_key(key, signer, epoch=name * 32, bundle=bundle, receivers=[receiver.public])
        for key, name in zip(keys, "fab", strict=True)
    ]
    source, observer = FreshSource(fresh_bundle), KeyObserver(fresh_bundle, receiver)
    image, measurement = np.zeros((28, 28), np.uint8), np.zeros((4, 5), np.float32)
    for number in (0, 1, 0, 2):
        assert observer.which(image, measurement, envelopes[number]) == number
        mask = source.make(keys[number], frozenset())
        assert np.array_equal(observer.levels(number), mask.levels)


def sample(epoch: str, mask: int, right: bool) -> Sample:
    return Sample(epoch, mask, right, settle=0.1, capture=0.02, rest=0.004)


def test_long_table_is_cut_short() -> None:
    table = Tally(
        [sample(f"{number:032}", number, True) for number in range(EPOCHS_SHOWN + 7)]
    ).table()
    assert table.row_count == EPOCHS_SHOWN + 2
    assert "and 7 more" in list(table.columns[0].cells)


def test_tally_counts() -> None:
    tally = Tally([sample("a", 0, True), sample("a", 0, False), sample("b", 2, True)])
    assert tally.summary() == "accuracy=0.667 captures=3 masks=2"
    assert tally.table().row_count == 3
    assert list(tally.table().columns[-1].cells) == ["4.0"] * 3


def test_drawn_block_shows_every_byte() -> None:
    block = bytes(range(256)) * 5 + b"\7"
    for shape in ((24, 32), (3, 4), (4, 3), (1, 1)):
        drawn = draw_block(block, shape)
        shown = drawn[np.isfinite(drawn)]
        assert bytes(shown.astype(np.uint8)) == block
        assert drawn.size - shown.size < drawn.shape[1]
        assert math.isclose(drawn.shape[0] / drawn.shape[1], shape[0] / shape[1], rel_tol=0.05)


def test_drawn_mask_shows_levels_filters_and_dead_space(bundle: Bundle) -> None:
    rows, columns = bundle.camera.mask_shape
    levels = np.zeros((rows, columns), np.uint8)
    levels[1, 2] = 63
    drawn = draw_mask(levels, bundle.camera)
    assert drawn.shape == (rows * 12, columns * 36, 3)
    cell = drawn[12:24, 72:108]
    assert np.max(cell) > 0.9
    assert not cell[0].any()
    assert not cell[:, 0].any()
    assert drawn.sum() == pytest.approx(cell.sum())
    assert not np.array_equal(
        draw_mask(np.full_like(levels, 63), bundle.camera)[6, 18],
        draw_mask(np.full_like(levels, 63), bundle.camera)[18, 18],
    )
