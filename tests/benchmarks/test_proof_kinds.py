"""Every kind of scene is drawn alone, and counted as what it was taken for."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.proof.__main__ import shipped_tests
from benchmarks.proof.kinds import by_kind
from benchmarks.proof.scenes import every_kind

from veilcam_server.demo_data import FRESH, load_digits
from veilcam_training.bundle import read_bundle


def test_every_kind_is_light() -> None:
    chance = np.random.default_rng(2)
    for draw in every_kind(load_digits(), 20).values():
        scene = draw(60, chance)
        assert scene.shape == (60, 60)
        assert np.min(scene) >= 0
        assert np.max(scene) > 0


@pytest.mark.slow
def test_digits_tell_their_mask_and_a_wall_does_not() -> None:
    shares = by_kind(
        read_bundle(FRESH), load_digits(), shipped_tests, cameras=1, electrons=(3e7,), seed=4
    )
    by_name = {share.kind: share for share in shares}
    assert by_name["digit"].seen == by_name["digit"].found == 1
    assert by_name["wall"].seen < 0.5
    assert all(share.accused == 0 for share in shares)
