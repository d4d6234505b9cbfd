"""Faces are told apart where they leave raw, and by nothing in ciphertext."""

from __future__ import annotations

import pytest
import torch
import typer
from benchmarks.privacy.people import GALLERY, Plan, measured, parts_of

from veilcam_optics.camera.geometry import Scene
from veilcam_training.data import Images

SCENE = Scene(16, 16)
PLAN = Plan(masks=(160, 40, 200), blocks=(1, 1, 2), still=4, epochs=3)


def people(seed: int, persons: int) -> Images:
    random = torch.Generator().manual_seed(seed)
    groups = torch.arange(persons).repeat_interleave(3)
    labels = torch.randint(2, (len(groups),), generator=random)
    looks = torch.randint(120, (persons, 4, 4), generator=random)
    pixels = looks[groups].repeat_interleave(4, 1).repeat_interleave(4, 2)
    pixels[:, 6:10] += 130 * labels[:, None, None]
    return Images(pixels.to(torch.uint8), labels, groups)


def test_parts_share_no_person() -> None:
    learned, check, test = parts_of(people(1, 60), people(2, 5))
    assert learned.groups is not None
    assert check.groups is not None
    assert not torch.isin(learned.groups, check.groups).any()
    assert (len(learned), len(check), len(test)) == (162, 18, 15)
    with pytest.raises(typer.BadParameter, match="who they are"):
        parts_of(Images(learned.pixels, learned.labels), test)


@pytest.mark.thorough
def test_faces_are_read_raw_and_not_in_ciphertext() -> None:
    sources = {"glasses": (people(1, 80), people(2, GALLERY), people(3, GALLERY))}
    raw, sealed = (measured(sources, SCENE, form, PLAN, 1) for form in ("raw", "sealed"))
    assert set(raw) == set(sealed)
    # Areas of 200 captures, or of 50 averages, have standard errors of 0.041 and 0.082 at chance.
    assert raw["glasses"] > 0.5 + 6 * 0.041
    assert abs(sealed["glasses"] - 0.5) < 4 * 0.041
    assert abs(sealed["still_glasses"] - 0.5) < 4 * 0.082
    assert sealed["still_glasses"] < raw["still_glasses"]
    # 100 probes find their own among 50: by chance 2 of them, and 12 with a chance of 1e-6.
    assert raw["scene_rank1"] > 12
    assert max(sealed["scene_rank1"], sealed["person_rank1"]) <= 12
