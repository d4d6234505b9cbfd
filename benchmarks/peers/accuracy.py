"""The jobs of ``benchmarks.accuracy`` with other libraries in them, where they are installed.

waveprop and torchoptics (docs/accuracy.md says how to install them) do the same jobs, against the
same references, in the same run.

    python -m benchmarks.peers.accuracy --out accuracy
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer
from benchmarks.accuracy.__main__ import JobName, chosen, run
from benchmarks.accuracy.field_job import FieldJob
from benchmarks.accuracy.measure import Job, Setting
from benchmarks.accuracy.psf_job import PsfJob
from benchmarks.accuracy.transfer_job import TransferJob
from benchmarks.peers import torchoptics_peer, waveprop_peer


@dataclass(frozen=True, slots=True)
class Peer:
    """A library that can do some of the jobs."""

    name: str
    load: Callable[[], object]
    """Imports what is needed, or raises ImportError."""
    transfer: Callable[[TransferJob], Iterator[Setting]]
    psf: Callable[[PsfJob], Iterator[Setting]]
    field: Callable[[FieldJob], Iterator[Setting]]

    def missing(self) -> str:
        """Why the library cannot be used; empty where it can."""
        try:
            self.load()
        except ImportError as error:
            return f"{type(error).__name__}: {error}"
        return ""

    def settings(self, job: TransferJob | PsfJob | FieldJob) -> Iterator[Setting]:
        """Its ways to do one of the jobs."""
        if isinstance(job, TransferJob):
            return self.transfer(job)
        return self.psf(job) if isinstance(job, PsfJob) else self.field(job)


PEERS = (
    Peer(
        waveprop_peer.NAME,
        lambda: waveprop_peer.load("slm"),
        waveprop_peer.transfer_settings,
        waveprop_peer.psf_settings,
        waveprop_peer.field_settings,
    ),
    Peer(
        torchoptics_peer.NAME,
        lambda: importlib.import_module("torchoptics"),
        torchoptics_peer.transfer_settings,
        torchoptics_peer.psf_settings,
        torchoptics_peer.field_settings,
    ),
)
"""Every peer; a new one is one more entry."""


def with_peers(kind: TransferJob | PsfJob | FieldJob, peers: list[Peer]) -> Job:
    """A job with our settings and those of ``peers``."""
    job = kind.job()
    theirs = [setting for peer in peers for setting in peer.settings(kind)]
    return replace(job, settings=[*job.settings, *theirs])


def main(
    *,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer settings, a coarser scene.")
    ] = False,
    job: Annotated[JobName, typer.Option(help="Which job to run.")] = JobName.all,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("accuracy"),
    threads: Annotated[int, typer.Option(min=1, help="Threads of every method.")] = 1,
) -> None:
    """Measure our methods and those of every library that is installed."""
    reasons = {peer.name: peer.missing() for peer in PEERS}
    for name, reason in reasons.items():
        if reason:
            print(f"{name} is not in the comparison: {reason}")
    peers = [peer for peer in PEERS if not reasons[peer.name]]
    jobs = [with_peers(kind, peers) for kind in chosen(job, quick=quick)]
    run(jobs, quick=quick, out=out, threads=threads)


if __name__ == "__main__":
    typer.run(main)
