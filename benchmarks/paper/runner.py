"""Runner of a table's cells: each is one task of the workers, and is taken up where it ended."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from benchmarks.figures import Origin
from benchmarks.paper.grid import Cell
from benchmarks.paper.pictures import make_pictures
from benchmarks.paper.results import (
    CHECKPOINTS,
    CellResult,
    EpochRecord,
    Finished,
    cell_folder,
    load_result,
    save_finished,
)
from benchmarks.paper.stopwatch import EpochLines, Stopwatch, time_label
from veilcam_optics.camera.geometry import Camera
from veilcam_training.bundle import Hiding
from veilcam_training.data import Source, open_source, split
from veilcam_training.data.base import ReadOnce
from veilcam_training.experiments.executors import Executor
from veilcam_training.experiments.keyring import fit_bundle
from veilcam_training.experiments.records import provenance

SHARES = ("seen", "random_seen", "recognised", "random_recognised", "read", "random_read")
"""Figures of :class:`.Hiding` that stand beside an accuracy."""


def confusion(labels: Tensor, predictions: Tensor, classes: int) -> Tensor:
    """Count how often each class, a row, was taken for each class, a column.

    Args:
        labels: int64 (count,), the true classes.
        predictions: int64 (count,).
        classes: how many there are.

    Returns:
        int64 (classes, classes).
    """
    pairs = labels * classes + predictions
    return torch.bincount(pairs, minlength=classes**2).reshape(classes, classes)


@dataclass
class CellRunner:
    """Runs a cell wherever a worker is. Only its paths and its end travel there.

    Args:
        data: folder of the data set.
        work: folder of the cells; a broken-off one is taken up from its checkpoint there.
        device: that computes.
        until: time after which no cell is begun [s since 1970]; None for no end.
    """

    data: Path
    work: Path
    device: torch.device
    until: float | None = None

    def __post_init__(self) -> None:
        self._sources: dict[str, ReadOnce] = {}

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_sources": {}}  # images are read where they are needed

    def source(self, name: str) -> Source:
        """Data set ``name``, kept for the next cell."""
        if name not in self._sources:
            self._sources = {name: ReadOnce(open_source(name, self.data))}
        return self._sources[name]

    def __call__(self, cell: Cell) -> Finished | None:
        """Run ``cell``; None if it was too late to begin.

        Raises:
            TrainingError: settings or data that cannot be used.
        """
        if self.until is not None and time.time() >= self.until:
            return None
        source, settings = self.source(cell.settings.data), cell.settings
        watch = Stopwatch(self.device)
        fitted, bundle = fit_bundle(
            settings,
            source,
            Camera(),
            device=self.device,
            work=cell_folder(self.work, cell) / CHECKPOINTS,
            callbacks=[watch, EpochLines(cell.name)],
        )
        model, history, best = fitted.fit.model, fitted.fit.history, fitted.fit.best
        seconds, clock = watch.read(history)
        test = source.test()
        reader: nn.Module = model.reader()
        if settings.fresh is not None:  # reads scenes that a decoder of the mask estimates
            decoder = nn.Linear(model.encoder.setup.outputs, test.pixels[0].numel(), bias=False)
            reader = nn.Sequential(decoder, reader)
        counts = confusion(test.labels, fitted.logits.argmax(1), len(source.labels))
        hiding = None if bundle is None else bundle.hiding
        result = CellResult(
            settings=settings,
            fingerprint=settings.fingerprint(source),
            labels=source.labels,
            test_set=fitted.accuracy.test_set,
            test_accuracy=fitted.accuracy.value,
            validation_accuracy=best.validation_accuracy,
            best_epoch=best.number,
            epochs=tuple(
                EpochRecord.model_validate(epoch, from_attributes=True) for epoch in history
            ),
            confusion=tuple(map(tuple, counts.tolist())),
            hiding=None if hiding is None else _shares(hiding),
            seconds=seconds,
            clock=clock,
            inference_seconds=time_label(reader, model.encoder.setup.outputs),
            device=self.device.type,
            origin=Origin.here(),
            provenance=provenance(settings.model_dump(mode="json"), source.digests()),
        )
        pictures = None
        if settings.fresh is None:
            pictures = make_pictures(model, settings, split(source.training()).validation)
        return Finished(result, pictures, bundle)


def _shares(hiding: Hiding) -> dict[str, float]:
    found = {name: getattr(hiding, name) for name in SHARES}
    return {name: share for name, share in found.items() if share is not None}


def run_cells(
    cells: Sequence[Cell], runner: CellRunner, workers: Executor
) -> Iterator[tuple[CellResult, bool]]:
    """Results of ``cells``, those that were finished before first; True if it was run now.

    Raises:
        TrainingError: settings or data that cannot be used, or a cell in the work folder that was
            made with others.
    """
    left = []
    for cell in cells:
        fingerprint = cell.settings.fingerprint(runner.source(cell.settings.data))
        result = load_result(runner.work, cell, fingerprint)
        if result is None:
            left.append(cell)
        else:
            yield result, False
    for _, finished in workers.run(runner, left):
        if finished is not None:
            save_finished(runner.work, finished)
            yield finished.result, True
