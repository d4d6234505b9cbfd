"""Parts of the demonstration: tally and pictures."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from veilcam_server.demo.report import draw_block, draw_mask
from veilcam_server.demo.tally import EPOCHS_SHOWN, Sample, Tally

if TYPE_CHECKING:
    from veilcam_training.bundle import Bundle


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
