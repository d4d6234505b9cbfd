"""Other libraries in the jobs of the accuracy command, where they are installed."""

from __future__ import annotations

import pytest
import torch
from benchmarks.accuracy.field_job import FieldJob
from benchmarks.accuracy.measure import measure
from benchmarks.accuracy.transfer_job import TransferJob
from benchmarks.peers import accuracy

PEERS = accuracy.PEERS


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_peers_solve_the_same_problem(peer):  # type: ignore[no-untyped-def]
    """Independent code, same physics: each peer's field comes as near as sampling allows."""
    if reason := peer.missing():
        pytest.skip(reason)
    field = FieldJob(quick=True)
    errors = [
        measure(s, field.reference(), least=1, budget=1e-9).error
        for s in peer.field(field)
        if s.dials["oversampling"] == 3
    ]
    assert errors
    assert max(errors) < 5e-2


def test_waveprop_sees_the_same_scene_as_we_do() -> None:
    """Inversion, colours and scale agree: what is left is its sampling of the mask."""
    peer = next(peer for peer in PEERS if peer.name == "waveprop")
    if reason := peer.missing():
        pytest.skip(reason)
    job = TransferJob(quick=True)
    (chosen,) = peer.transfer(job)
    assert 1e-2 < measure(chosen, torch.empty(0), least=1, budget=1e-9).error < 0.1
