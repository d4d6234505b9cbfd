"""Averages over boxes, fractions of samples exact."""

from __future__ import annotations

import pytest
import torch

from veilcam_optics.propagation.sampling import area_average


@pytest.mark.parametrize(("n", "boxes"), [(10, 5), (10, 3), (7, 7), (3, 8), (1, 1), (507, 32)])
def test_area_average_is_exact(n: int, boxes: int) -> None:
    values = torch.rand(2, n, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    got = area_average(values, boxes, 4)
    assert torch.allclose(got.mean((1, 2)), values.mean((1, 2)), atol=1e-13)
    # The same by repeating every sample: whole numbers of them then fill every box.
    fine = values.repeat_interleave(boxes, dim=1).reshape(2, boxes, n, 4).mean(2)
    assert torch.allclose(got, fine, atol=1e-13)
