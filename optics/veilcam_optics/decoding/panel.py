"""What a panel with faults shows of the weights that it was told."""

from __future__ import annotations

from collections.abc import Iterable

from torch import Tensor

from veilcam_optics.errors import invalid


def with_dead_rows(weights: Tensor, rows: Iterable[int], transmittance: float = 0.0) -> Tensor:
    """Weights as a panel shows them whose ``rows`` are stuck.

    Args:
        weights: amplitude transmittances, (rows, columns).
        rows: mask rows that do not obey, from 0.
        transmittance: amplitude that a stuck row passes, in [0, 1]; 0 is dark.

    Returns:
        A copy with those rows replaced.

    Raises:
        OpticsError: a row that the mask does not have, or no transmittance.
    """
    dead = sorted(set(rows))
    if dead and not 0 <= dead[0] <= dead[-1] < weights.shape[0]:
        raise invalid("rows", dead, "", f"mask rows 0 to {weights.shape[0] - 1}")
    if not 0 <= transmittance <= 1:
        raise invalid("transmittance", transmittance, "", "0 to 1")
    shown = weights.clone()
    shown[dead] = transmittance
    return shown
