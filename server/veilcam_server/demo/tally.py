"""Tally of the demonstration, per mask epoch and in all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median

from rich.box import SIMPLE
from rich.table import Table

EPOCHS_SHOWN = 25
"""A table of all epochs would be too long where every capture has its own."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One classified digit; times in seconds."""

    epoch: str
    mask: int
    right: bool
    settle: float
    capture: float
    rest: float
    """What the client waited beside the device: classifying, sealing and HTTP."""


@dataclass(slots=True)
class Tally:
    """All samples in order."""

    samples: list[Sample] = field(default_factory=list)

    @property
    def accuracy(self) -> float:
        """Share of digits that were classified right."""
        return sum(sample.right for sample in self.samples) / len(self.samples)

    @property
    def masks(self) -> int:
        """Number of masks that were in use."""
        return len({sample.mask for sample in self.samples})

    def summary(self) -> str:
        """Return the last line of the demonstration."""
        return f"accuracy={self.accuracy:.3f} captures={len(self.samples)} masks={self.masks}"

    def table(self) -> Table:
        """One row per mask epoch, and one for all."""
        table = Table(title="Median times in ms", box=SIMPLE, pad_edge=False, padding=(0, 1, 0, 0))
        table.add_column("mask epoch", no_wrap=True)
        table.add_column("mask", justify="right", no_wrap=True)
        for name in ("captures", "accuracy", "settle", "capture", "classify + HTTP"):
            table.add_column(name, justify="right", no_wrap=True)
        epochs = list(dict.fromkeys(sample.epoch for sample in self.samples))
        for epoch in epochs[:EPOCHS_SHOWN]:
            some = [sample for sample in self.samples if sample.epoch == epoch]
            # The first capture under a mask waits for the panel; the others find it settled.
            table.add_row(epoch[:16], f"#{some[0].mask + 1}", *_cells(some, some[:1]))
        if len(epochs) > EPOCHS_SHOWN:
            table.add_row(f"and {len(epochs) - EPOCHS_SHOWN} more")
        table.add_section()
        firsts = [
            sample
            for before, sample in zip([None, *self.samples], self.samples, strict=False)
            if before is None or before.epoch != sample.epoch
        ]
        table.add_row("all", str(self.masks), *_cells(self.samples, firsts), style="bold")
        table.caption = "settle: what the first capture under a mask waited for the panel"
        return table


def _cells(samples: Sequence[Sample], firsts: Sequence[Sample]) -> tuple[str, ...]:
    def milliseconds(times: Sequence[float]) -> str:
        return f"{1e3 * median(times):.1f}"

    return (
        str(len(samples)),
        f"{sum(sample.right for sample in samples) / len(samples):.3f}",
        milliseconds([sample.settle for sample in firsts]),
        milliseconds([sample.capture for sample in samples]),
        milliseconds([sample.rest for sample in samples]),
    )
