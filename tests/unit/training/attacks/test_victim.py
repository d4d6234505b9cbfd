"""The victim gives what a camera gives, and its forms are those of the product."""

import math

import pytest
import torch
from scipy.stats import kstest
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.decoding import SceneDecoding, fit_statistics
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.attacks.victim import (
    FORMS,
    FreshMasks,
    MaskSource,
    Prepared,
    ReleaseRule,
    StoredMasks,
    Victim,
    VictimMask,
    raw,
)
from veilcam_training.errors import TrainingError

CAMERA, SCENE, EMBEDDING = Camera(), Scene(8, 8), Embedding(3, 4)


@pytest.fixture(scope="module")
def light() -> TransferOperator:
    return TransferOperator(CAMERA, SCENE, EMBEDDING)


@pytest.fixture(scope="module")
def decoding(light: TransferOperator) -> SceneDecoding:
    return SceneDecoding(light, fit_statistics([_scenes(200)], 20))


def _scenes(count: int) -> Tensor:
    return torch.rand(count, *SCENE.shape, generator=torch.Generator().manual_seed(5))


def _fresh() -> FreshMasks:
    return FreshMasks(CAMERA, MaskDistribution.uniform(CAMERA))


def _victim(
    light: TransferOperator,
    source: MaskSource,
    release: ReleaseRule = raw,
    *,
    decoding: SceneDecoding | None = None,
    snr_db: float = 40.0,
) -> Victim:
    generator = torch.Generator().manual_seed(3)
    return Victim(light, source, release, decoding=decoding, snr_db=snr_db, generator=generator)


def test_capture_is_the_light_of_its_mask_at_the_ratio_asked_for(light: TransferOperator) -> None:
    victim = _victim(light, _fresh(), snr_db=math.inf)
    mask, scenes = victim.mask(), _scenes(50)
    clear = victim.capture(mask, scenes)
    assert torch.equal(clear, scenes.flatten(1) @ mask.transfer)
    noise = _victim(light, _fresh(), snr_db=20.0).capture(mask, scenes) - clear
    ratio = 10 * (clear.square().sum() / noise.square().sum()).log10()
    # 600 squares of normals: 6 % of the noise's energy is .25 dB; four of those.
    assert float(ratio) == pytest.approx(20, abs=1)


def test_fresh_masks_never_come_again_and_stored_ones_do(light: TransferOperator) -> None:
    fresh = _victim(light, _fresh())
    drawn = [fresh.mask() for _ in range(6)]
    assert len({mask.weights.numpy().tobytes() for mask in drawn}) == 6
    assert {mask.place for mask in drawn} == {-1}
    stored = StoredMasks.random(CAMERA, 2, torch.Generator().manual_seed(1))
    again = [_victim(light, stored).mask() for _ in range(3)]
    assert all(torch.equal(mask.weights, stored.weights[mask.place]) for mask in again)
    victim = _victim(light, stored)
    shown = [victim.mask() for _ in range(20)]
    assert {mask.place for mask in shown} == {0, 1}
    # No two captures of an epoch are sealed alike, in one call or in two.
    sealer = _victim(light, stored, FORMS["sealed"])
    mask, scene = sealer.mask(), _scenes(1)
    sent = torch.cat([sealer.capture(mask, scene), sealer.capture(mask, scene)])
    assert not torch.equal(sent[0, :64], sent[1, :64])
    # The name tells the epoch, never the mask.
    assert [mask.epoch for mask in shown] == list(range(1, 21))
    assert len({mask.key for mask in shown}) == 20


def test_stored_masks_are_prepared_once_for_all_their_cameras(light: TransferOperator) -> None:
    stored = StoredMasks.random(CAMERA, 2, torch.Generator().manual_seed(1))
    shared: dict[int, Prepared] = {}
    cameras = [
        Victim(light, stored, raw, generator=torch.Generator().manual_seed(seed), prepared=shared)
        for seed in (1, 2)
    ]
    one, other = (camera.leak(1) for camera in cameras)
    assert len(one) == len(other) == len(shared) == 2
    for mine, theirs in zip(one, other, strict=True):
        assert mine.transfer is theirs.transfer
        assert mine.key != theirs.key
    # What never comes again is kept by nobody.
    fresh = Victim(light, _fresh(), raw, generator=torch.Generator(), prepared=shared)
    assert len(fresh.leak(3)) == 3
    assert len(shared) == 2


def test_release_of_ones_own_is_taken(light: TransferOperator) -> None:
    def doubled(mask: VictimMask, measurements: Tensor) -> Tensor:
        return 2 * measurements + mask.epoch

    clear = _victim(light, _fresh(), snr_db=math.inf)
    victim = _victim(light, _fresh(), snr_db=math.inf, release=doubled)
    scenes = _scenes(4)
    wanted = 2 * clear.capture(clear.mask(), scenes) + 1
    assert torch.equal(victim.capture(victim.mask(), scenes), wanted)


def test_sealed_bytes_are_uniform_whatever_was_seen(light: TransferOperator) -> None:
    victim = _victim(light, _fresh(), release=FORMS["sealed"])
    seen = victim.capture(victim.mask(), _scenes(1).expand(300, -1, -1))
    assert seen.shape == (300, 4 * EMBEDDING.size + 16)
    # Levels of bytes against the uniform; a false alarm in 10,000 with this seed's only draw.
    assert kstest(seen.flatten().numpy(), "uniform", args=(-(3**0.5), 2 * 3**0.5)).pvalue > 1e-4
    assert float(seen.var()) == pytest.approx(1, abs=0.03)


def test_watching_gives_a_mask_to_every_row(light: TransferOperator) -> None:
    seen = _victim(light, _fresh()).watch(_scenes(6).reshape(3, 2, *SCENE.shape))
    assert seen.released.shape == (3, 2, EMBEDDING.size)
    assert seen.epochs.tolist() == [1, 2, 3]
    assert "weights" not in repr(seen)
    with pytest.raises(TrainingError, match="store one"):
        StoredMasks([])
