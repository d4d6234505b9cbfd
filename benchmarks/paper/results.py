"""Finished cells of a table: their files, their places, and their test accuracies in a record."""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from pathlib import Path
from statistics import mean, stdev
from typing import Any, Literal, TypeAlias

from pydantic import BaseModel, JsonValue, ValidationError
from scipy.stats import t as student

from benchmarks.figures import Origin, record_figures
from benchmarks.paper.grid import Cell, Column, Place, Row, Table
from benchmarks.paper.pictures import Pictures, save_pictures
from benchmarks.paper.stopwatch import Clock
from veilcam_optics.files import write_whole
from veilcam_training.bundle import Bundle, write_bundle
from veilcam_training.config.settings import FitSettings
from veilcam_training.errors import TrainingError, require

RESULT = "result.json"
PICTURES = "pictures.npz"
BUNDLE = "pair.veilcam"
CHECKPOINTS = "checkpoints"
SEEDS_FOR_A_VERDICT = 3
_LEVEL = 0.95
HIDING = ("seen", "recognised", "read")
"""What attackers without the key do, by the names of :class:`.Hiding`."""
_ROUNDING = 0.05
"""The paper's percents have one digit after the point."""

Verdict: TypeAlias = Literal["win", "loss", "tie"]


def verdict_of(
    test: float, interval: float | None, seeds: int, paper: float | None
) -> Verdict | None:
    """Return whether the paper's number is outside of an interval, by more than its rounding.

    Args:
        test: mean test accuracy [percent].
        interval: half of the interval of the mean [percent].
        seeds: number of seeds. Fewer than three give None: runs that differ in their seed alone
            differ by as much as many cells do from the paper's.
        paper: the paper's number [percent].
    """
    if paper is None or interval is None or seeds < SEEDS_FOR_A_VERDICT:
        return None
    if abs(test - paper) <= interval + _ROUNDING:
        return "tie"
    return "win" if test > paper else "loss"


class EpochRecord(BaseModel, frozen=True, extra="forbid"):
    """One epoch's accuracies in [0, 1]."""

    loss: float
    training_accuracy: float
    validation_accuracy: float
    validation_loss: float


class CellResult(BaseModel, frozen=True, extra="forbid"):
    """The numbers of a finished cell; accuracies in [0, 1]."""

    settings: FitSettings
    fingerprint: str
    """Of all that the numbers depend on."""
    labels: tuple[str, ...]
    test_set: str
    test_accuracy: float
    validation_accuracy: float
    best_epoch: int
    """From 0."""
    epochs: tuple[EpochRecord, ...]
    confusion: tuple[tuple[int, ...], ...]
    """Of the test set: a row for each true class, a column for each predicted one."""
    hiding: dict[str, float] | None = None
    """Shares that attackers without the key get right, by the names of :class:`.Hiding`."""
    seconds: float
    """All epochs together."""
    clock: Clock = "elapsed"
    """Which measured ``seconds``, see :mod:`benchmarks.paper.stopwatch`."""
    inference_seconds: float
    """From one measurement to its label, see ``stopwatch.time_label``."""
    device: str
    origin: Origin
    provenance: dict[str, JsonValue]

    @property
    def cell(self) -> Cell:
        """Where it belongs."""
        return Cell(self.settings)

    def numbers(self) -> dict[str, Any]:
        """What another run with the same seed must give again: all but times and origin."""
        changing = {"seconds", "clock", "inference_seconds", "device", "origin", "provenance"}
        return self.model_dump(mode="json", exclude=changing)


@dataclass(frozen=True)
class Finished:
    """All of a finished cell: no bundle without a panel, and no pictures of fresh masks."""

    result: CellResult
    pictures: Pictures | None
    bundle: Bundle | None


def save_finished(work: Path, finished: Finished) -> None:
    """Write a cell into its folder in ``work``; its numbers come last and say that all is there."""
    folder = cell_folder(work, finished.result.cell)
    folder.mkdir(parents=True, exist_ok=True)
    if finished.bundle is not None:
        write_bundle(folder / BUNDLE, finished.bundle)
    if finished.pictures is not None:
        save_pictures(folder / PICTURES, finished.pictures)
    write_whole(folder / RESULT, f"{finished.result.model_dump_json(indent=1)}\n".encode())
    shutil.rmtree(folder / CHECKPOINTS, ignore_errors=True)


def load_result(work: Path, cell: Cell, fingerprint: str) -> CellResult | None:
    """The result of ``cell``, or None if it is not finished.

    Raises:
        TrainingError: the file is damaged, or of other settings, data or torch.
    """
    path = cell_folder(work, cell) / RESULT
    if not path.exists():
        return None
    result = _read(path)
    require(
        result.fingerprint == fingerprint,
        f"{path.parent} was made with other settings, data or torch: "
        "remove it to run it again, or use another --work",
    )
    return result


def load_results(work: Path) -> Iterator[CellResult]:
    """Every finished cell in ``work``, whatever its settings, by name.

    Raises:
        TrainingError: a file is damaged.
    """
    for path in sorted(work.glob(f"*/{RESULT}")):
        yield _read(path)


def cell_folder(work: Path, cell: Cell) -> Path:
    """Folder of ``cell`` in the folder ``work``."""
    return work / cell.name


def _read(path: Path) -> CellResult:
    try:
        return CellResult.model_validate_json(path.read_text())
    except (OSError, UnicodeDecodeError, ValidationError):
        raise TrainingError(
            f"{path} is not the result of a cell: remove {path.parent} to run it again"
        ) from None


def by_place(results: Sequence[CellResult]) -> Mapping[Place, tuple[CellResult, ...]]:
    """``results`` by their place in a table, the least seed first.

    Raises:
        TrainingError: two of one place differ in more than their seed.
    """
    places: dict[Place, list[CellResult]] = {}
    for result in sorted(results, key=lambda result: result.settings.seed):
        group = places.setdefault(result.cell.place, [])
        group.append(result)
        first = group[0].settings
        require(
            result.settings.model_copy(update={"seed": first.seed}) == first,
            f"cells {group[0].cell.name} and {result.cell.name} differ in more than their "
            "seed, so they have no mean: move one of their folders to another --work",
        )
    return {place: tuple(group) for place, group in places.items()}


@dataclass(frozen=True)
class Entry:
    """What stands in one place of a table; accuracies and differences in percent."""

    place: Place
    results: tuple[CellResult, ...]
    """One for each seed, the least first; none if it has not been run."""

    @property
    def test(self) -> float | None:
        """Mean test accuracy."""
        return 100 * mean(r.test_accuracy for r in self.results) if self.results else None

    @property
    def validation(self) -> float | None:
        """Mean validation accuracy."""
        return 100 * mean(r.validation_accuracy for r in self.results) if self.results else None

    @property
    def interval(self) -> float | None:
        """Half of the 95 % interval of the mean over seeds, by Student's t; None of one seed.

        Other seeds are what it is about: all of them read one test set.
        """
        count = len(self.results)
        if count < 2:
            return None
        spread = stdev(result.test_accuracy for result in self.results)
        return 100 * float(student.ppf((1 + _LEVEL) / 2, count - 1)) * spread / sqrt(count)

    @property
    def paper(self) -> float | None:
        """The paper's test accuracy."""
        return self.place.paper

    @property
    def difference(self) -> float | None:
        """Test accuracy less the paper's, to the digit that the paper gives."""
        if self.test is None or self.paper is None:
            return None
        return round(self.test - self.paper, 1) + 0.0  # no -0.0

    @property
    def verdict(self) -> Verdict | None:
        """Of the mean beside the paper's number, see :func:`verdict_of`."""
        if self.test is None:
            return None
        return verdict_of(self.test, self.interval, len(self.results), self.paper)


class Summary:
    """A table with what is finished of it.

    Args:
        table: says what its rows and columns are.
        results: cells that belong to it.

    Raises:
        TrainingError: see :func:`by_place`.
    """

    def __init__(self, table: Table, results: Sequence[CellResult]) -> None:
        self.table = table
        places = by_place(results)
        self.columns = table.columns([place.column for place in places])
        self.rows = tuple(table.rows([place.row for place in places]))
        self._entries = [
            [
                Entry(Place(row, column), places.get(Place(row, column), ()))
                for column in self.columns
            ]
            for row in self.rows
        ]

    def entries(self, row: Row) -> list[Entry]:
        """What stands in ``row``, column by column."""
        return self._entries[self.rows.index(row)]

    def finished(self) -> list[Entry]:
        """Every place that has been run, row by row."""
        return [entry for row in self._entries for entry in row if entry.results]

    def finished_columns(self, entries: Sequence[Entry]) -> list[Column]:
        """The columns in which one of ``entries`` stands."""
        return [c for c in self.columns if any(entry.place.column == c for entry in entries)]

    def find(self, row: Row, column: Column) -> Entry | None:
        """What stands in ``row`` and ``column``, if there are such and it has been run."""
        for entry in self.finished():
            if entry.place == Place(row, column):
                return entry
        return None


def record_cells(path: Path, results: Sequence[CellResult]) -> None:
    """Write test accuracies [percent] into the record at ``path``.

    Several seeds of one cell give their mean, beside it half of its interval and their number; and
    each cell has the shares that attackers without the key get right [percent]. Each figure has the
    command, commit, date and machine of the cell; of several, every command and commit, and the
    last one's date and machine.
    ``robust_<change>`` is that of the classifier which validates best behind a learned mask.

    Raises:
        TrainingError: see :func:`by_place`; or what is at ``path`` is
            no such record.
    """
    by_name = {place.figure: group for place, group in by_place(results).items()}
    for change in {result.settings.change for result in results} - {"none"}:
        learned = [
            group
            for group in by_name.values()
            if group[0].settings.change == change
            and group[0].cell.place.row[1:] == ("learned", "area")
        ]
        if learned:
            by_name[f"robust_{change}"] = max(learned, key=_validation_accuracy)
    for name, group in by_name.items():
        entry = Entry(group[0].cell.place, tuple(group))
        values: dict[str, float | None] = {name: entry.test, f"{name}_interval": entry.interval}
        if entry.interval is not None:
            values[f"{name}_seeds"] = len(group)
        for each in HIDING:
            hidings = [result.hiding for result in group if result.hiding is not None]
            shares = [shares[each] for shares in hidings if each in shares]
            values[f"{name}_{each}"] = 100 * mean(shares) if shares else None
        found = {key: round(value, 2) for key, value in values.items() if value is not None}
        record_figures(path, found, origin=_origin(group))


def _origin(group: Sequence[CellResult]) -> Origin:
    origins = sorted((result.origin for result in group), key=lambda origin: origin.date)
    return replace(
        origins[-1],
        command="; ".join(dict.fromkeys(origin.command for origin in origins)),
        commit=", ".join(dict.fromkeys(origin.commit for origin in origins)),
    )


def _validation_accuracy(group: Sequence[CellResult]) -> float:
    return mean(result.validation_accuracy for result in group)
