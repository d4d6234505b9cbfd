"""Runs a room's tests on mutants, each in a copy of the repository."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import queue
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from .operators import Mutant
from .results import Outcome, Result
from .subjects import Subject

PACKAGES = ("client", "optics", "training", "server")
PATIENCE, LEAST = 5.0, 30.0
"""A mutant may take so many times as long as the original did, and at least so long [s]: what takes
longer does not end. Another load on the machine must not look like that."""


def list_files(root: Path) -> list[str]:
    """Files of the repository that are there and that git does not ignore."""
    listed = subprocess.run(
        ["git", "-C", root, "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    return sorted(name for name in set(listed.split("\0")) if name and (root / name).is_file())


def digest(root: Path, files: Sequence[str]) -> str:
    """SHA-256 of all files: results hold for the very same repository alone."""
    total = hashlib.sha256()
    for name in files:
        total.update(f"{name}\0".encode())
        total.update(hashlib.sha256((root / name).read_bytes()).digest())
    return total.hexdigest()


@dataclass(frozen=True, slots=True)
class Copy:
    """A copy of the repository in which one mutant at a time is put to the test."""

    root: Path

    @classmethod
    def make(cls, source: Path, files: Sequence[str], target: Path) -> Copy:
        """Copy ``files`` from ``source`` to ``target``, which is made."""
        for name in files:
            place = target / name
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source / name, place)
        return cls(target)

    def try_mutant(self, mutant: Mutant, tests: Sequence[str], limit: float) -> Outcome:
        """Whether tests that pass on the original fail on a mutant.

        Args:
            mutant: of a file of the repository.
            tests: paths of the room's tests.
            limit: after which tests are stopped [s].
        """
        with self._mutated(mutant):
            code = self.run(tests, limit)
        return "timeout" if code is None else "killed" if code else "survived"

    def run(self, tests: Sequence[str], limit: float | None = None) -> int | None:
        """Exit status of pytest; None: it was stopped after ``limit`` seconds."""
        packages = os.pathsep.join(str(self.root / name) for name in PACKAGES)
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests],
            cwd=self.root,
            env={**os.environ, "PYTHONPATH": packages, "OMP_NUM_THREADS": "1"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            return process.wait(limit)
        except subprocess.TimeoutExpired:
            return None
        finally:
            # The group, for a test may have started processes of its own.
            _end(process)

    def measure(self, tests: Sequence[str]) -> float:
        """Seconds that the original takes.

        Raises:
            RuntimeError: the tests fail without any mutant.
        """
        began = time.monotonic()
        if self.run(tests):
            raise RuntimeError(f"{' '.join(tests)} fail on the original: run pytest on them")
        return time.monotonic() - began

    @contextmanager
    def _mutated(self, mutant: Mutant) -> Iterator[None]:
        path = self.root / mutant.file
        original = path.read_text()
        try:
            _write(path, mutant.apply(original))
            yield
        finally:
            _write(path, original)


class Runner:
    """Tries mutants, several at a time.

    Args:
        copies: of the repository, one for each mutant that is tried at the same time.
        tree: digest of the repository.
    """

    def __init__(self, copies: Sequence[Copy], tree: str) -> None:
        self._tree, self._workers = tree, len(copies)
        self._idle: queue.SimpleQueue[Copy] = queue.SimpleQueue()
        for copy in copies:
            self._idle.put(copy)

    def run(self, mutants: Mapping[Subject, Sequence[Mutant]]) -> Iterator[Result]:
        """Results as they come.

        Raises:
            RuntimeError: the tests of a subject fail without any mutant.
        """
        subjects = [subject for subject, own in mutants.items() if own]
        pool = ThreadPoolExecutor(self._workers)
        try:
            limits = dict(zip(subjects, pool.map(self._limit, subjects), strict=True))
            runs = [
                pool.submit(self._try, subject, mutant, limits[subject])
                for subject in subjects
                for mutant in mutants[subject]
            ]
            for run in as_completed(runs):
                yield run.result()
        finally:
            pool.shutdown(cancel_futures=True)

    def _limit(self, subject: Subject) -> float:
        with self._copy() as copy:
            return max(LEAST, PATIENCE * copy.measure(subject.tests))

    def _try(self, subject: Subject, mutant: Mutant, limit: float) -> Result:
        with self._copy() as copy:
            outcome = copy.try_mutant(mutant, subject.tests, limit)
        return Result(self._tree, subject.name, mutant, outcome)

    @contextmanager
    def _copy(self) -> Iterator[Copy]:
        copy = self._idle.get()
        try:
            yield copy
        finally:
            self._idle.put(copy)


def _write(path: Path, source: str) -> None:
    path.write_text(source)
    # Two edits within a second may have the same size, and byte code is told by size and second.
    Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)


def _end(process: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
