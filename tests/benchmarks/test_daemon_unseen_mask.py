"""The benchmark of masks that are not there, made short; and that it would notice them."""

from __future__ import annotations

import asyncio
import math
import random
from functools import partial
from itertools import cycle
from pathlib import Path

import pytest
from benchmarks.daemon import unseen_mask
from benchmarks.daemon.unseen_mask import FAULTS, ROUTES, Oracle, Tally, ask, served
from tests.server.conftest import FakeMaskTests

from veilcam_client.keys.epoch_key import KEY_BYTES, EpochKey
from veilcam_client.wire.simulation import PanelFaults
from veilcam_server import daemon
from veilcam_server.demo_data import BUNDLE, FRESH
from veilcam_server.settings import Settings

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def certain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three fresh masks in turn, and no noise: what an open window lets be seen is no chance.

    Which capture is behind which of them rests on threads, so all three must be told apart.
    """
    masks = random.Random(15)
    turn = cycle([masks.randbytes(KEY_BYTES) for _ in range(3)])
    monkeypatch.setattr(EpochKey, "levels", lambda _: bytearray(next(turn)))
    monkeypatch.setattr(unseen_mask, "Settings", partial(Settings, snr_db=math.inf))


def counted(bundle: Path, folder: Path) -> dict[str, Tally]:
    """What a daemon answers to six captures behind each fault."""
    return asyncio.run(unseen_mask.measure(bundle, folder, captures=6))


@pytest.mark.parametrize("bundle", [BUNDLE, FRESH])
def test_nothing_is_answered_under_a_mask_that_is_not_there(bundle: Path, tmp_path: Path) -> None:
    tallies = counted(bundle, tmp_path)
    assert {name: (tally.tried, tally.unseen) for name, tally in tallies.items()} == dict.fromkeys(
        FAULTS, (6, 0)
    )
    dead, lost = tallies["dead_panel"], tallies["lost_write"]
    assert (dead.answered, dead.caught, dead.wrong) == (0, 6, 6)
    # Every ninth write is not every ninth mask, but a round or two lose some.
    assert lost.wrong == lost.caught
    assert dead.sound_refused == lost.sound_refused == lost.blamed == 0


def test_a_daemon_that_believes_its_panel_answers_under_masks_that_are_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(daemon, "mask_tests", lambda *_, **__: FakeMaskTests())
    tallies = counted(BUNDLE, tmp_path)
    dead, lost = tallies["dead_panel"], tallies["lost_write"]
    assert (dead.tried, dead.answered, dead.unseen, dead.caught) == (6, 6, 6, 0)
    assert lost.unseen == lost.wrong > 0


def test_behind_a_sound_panel_every_capture_is_answered_and_its_mask_is_there(
    tmp_path: Path,
) -> None:
    async def sound() -> Tally:
        oracle = Oracle()
        async with served(BUNDLE, tmp_path, oracle) as client:
            return await ask(client, oracle, PanelFaults(), captures=2 * len(ROUTES))

    tally = asyncio.run(sound())
    assert tally == Tally(tried=4, answered=4, sound=1)
