"""Runs: many cameras, one after the other, each counted into a file of its own.

A run that was cut short goes on where it was: a camera that has its file is not drawn again.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal, Protocol, Self, TypeVar

import numpy as np
import numpy.typing as npt
from benchmarks.proof.captures import LEVELS
from benchmarks.proof.world import Batch, Extent, World

from veilcam_optics.files import write_whole
from veilcam_optics.keys.masks import Levels
from veilcam_optics.proof import Finding
from veilcam_server.demo_data import BUNDLE, FRESH, load_digits
from veilcam_training.bundle import read_bundle

Kind = Literal["healthy", "faulty"]
BUNDLES: Mapping[str, Path] = {"fresh": FRESH, "pairs": BUNDLE}
TOGETHER = 70
"""Captures that are tested at once: as many as a processor's cache holds."""
TOLD = 20
"""Findings of a camera that are told one by one, at most."""


class CaptureTest(Protocol):
    """Of captures behind one mask."""

    def find_each(
        self,
        measurements: npt.NDArray[np.float32],
        clipped: npt.NDArray[np.bool_],
        before: Sequence[Self],
    ) -> list[Finding]:
        """What each capture says of its mask."""


Test_co = TypeVar("Test_co", bound=CaptureTest, covariant=True)


class Preparation(Protocol[Test_co]):
    """Of the tests of one camera."""

    def prepare(self, levels: Levels) -> Test_co:
        """The test of captures behind one mask."""


@dataclass(frozen=True)
class Job:
    """One camera.

    Attributes:
        kind: whether its panel does what it is told.
        bundle: name of one of :data:`BUNDLES`.
        seed: of the run.
        number: of the camera in it.
        extent: how much it sees.
    """

    kind: Kind
    bundle: str
    seed: int
    number: int
    extent: Extent

    @property
    def name(self) -> str:
        """Of the camera, and of its file."""
        return f"{self.kind}-{self.bundle}-{self.seed}-{self.number}"


@dataclass
class Tally:
    """What was found of one camera.

    Attributes:
        job: that it was counted by.
        verdicts: by state of the panel, level of the light and verdict.
        least_margin: of what was seen or undecided, by state and level [nat].
        told: findings that a healthy camera should not have, or that missed a fault.
    """

    job: dict[str, Any]
    verdicts: dict[str, int] = field(default_factory=dict)
    least_margin: dict[str, float] = field(default_factory=dict)
    told: list[dict[str, Any]] = field(default_factory=list)

    def add(self, batch: Batch, findings: Sequence[Finding]) -> None:
        """Count a batch."""
        for place, (level, found) in enumerate(zip(batch.plan.level, findings, strict=True)):
            key = f"{batch.state}/{LEVELS[level]}"
            counted = f"{key}/{found.verdict}"
            self.verdicts[counted] = self.verdicts.get(counted, 0) + 1
            least = self.least_margin.get(key, found.margin)
            self.least_margin[key] = min(least, found.margin)
            wrong = "not seen" if batch.state == "healthy" else "seen"
            if found.verdict == wrong and len(self.told) < TOLD:
                self.told.append({"state": batch.state, "level": LEVELS[level], "place": place})
                self.told[-1].update(asdict(found))

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a camera's file."""
        return cls(**json.loads(path.read_text()))

    def write(self, path: Path) -> None:
        """Write a camera's file."""
        write_whole(path, json.dumps(asdict(self), indent=1).encode())


def tallied(batches: Iterable[Batch], tests: Preparation[Test_co], job: Job) -> Tally:
    """Test every capture against the mask that it names.

    As in the daemon where captures are undecided, the two masks before are told from each.
    """
    tally = Tally(asdict(job))
    shown: list[tuple[Levels, Test_co]] = []
    for batch in batches:
        if not shown:
            shown = [(levels, tests.prepare(levels)) for levels in (batch.earlier, batch.before)]
        if shown[-1][0] is not batch.levels:
            shown = [*shown[-2:], (batch.levels, tests.prepare(batch.levels))]
        *before, due = (test for _, test in shown)
        found: list[Finding] = []
        for first in range(0, len(batch.plan), TOGETHER):
            some = slice(first, first + TOGETHER)
            found += due.find_each(batch.measurements[some], batch.clipped[some], before)
        tally.add(batch, found)
    return tally


def run(
    work: Path,
    jobs: Sequence[Job],
    tests: Callable[[World], Preparation[Test_co]],
    workers: int,
) -> list[Tally]:
    """Do what is left to be done, and return all.

    Args:
        work: folder of the cameras' files.
        jobs: of the run.
        tests: makes a camera's tests from what is believed of it.
        workers: processes at once.
    """
    work.mkdir(parents=True, exist_ok=True)
    left = [job for job in jobs if not (work / f"{job.name}.json").exists()]
    for done, name in enumerate(_each(partial(do, work, tests=tests), left, workers), 1):
        print(f"{name}: {done} of {len(left)}", file=sys.stderr, flush=True)
    tallies = [Tally.read(work / f"{job.name}.json") for job in jobs]
    for tally, job in zip(tallies, jobs, strict=True):
        if tally.job != asdict(job):
            raise ValueError(f"{work} holds another run: give it a folder of its own")
    return tallies


def do(work: Path, job: Job, tests: Callable[[World], Preparation[Test_co]]) -> str:
    """Count one camera, and return its name."""
    seed = np.random.SeedSequence([job.seed, job.number, *job.name.encode()])
    world = World(read_bundle(BUNDLES[job.bundle]), load_digits(), seed, job.extent)
    batches: Iterator[Batch] = world.healthy() if job.kind == "healthy" else world.faulty()
    tallied(batches, tests(world), job).write(work / f"{job.name}.json")
    return job.name


def _each(count: Callable[[Job], str], jobs: Sequence[Job], workers: int) -> Iterator[str]:
    if workers == 1:
        yield from map(count, jobs)
        return
    with ProcessPoolExecutor(workers) as pool:
        yield from pool.map(count, jobs)
