"""Other libraries in the jobs of the accuracy command, where they are installed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest
import torch
from benchmarks.accuracy.field_job import FieldJob
from benchmarks.accuracy.measure import Setting, measure
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


def test_peers_join_the_chart_and_say_why_they_do_not() -> None:
    def nothing(_: object) -> Iterator[Setting]:
        return iter(())

    class Absent:
        def load(self) -> None:
            raise ImportError("no such library")

    job = FieldJob(quick=True)
    ours = [setting.label for setting in job.job().settings]
    theirs = replace(job.job().settings[0], method="another")
    there = accuracy.Peer("there", lambda: None, nothing, nothing, lambda _: iter([theirs]))
    absent = accuracy.Peer("absent", Absent().load, nothing, nothing, nothing)
    assert (there.missing(), absent.missing()) == ("", "ImportError: no such library")
    joined = accuracy.with_peers(job, [there]).settings
    assert [setting.label for setting in joined] == [*ours, theirs.label]
