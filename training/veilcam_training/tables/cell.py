"""A cell of a table: one fit, and the name that it goes by."""

from __future__ import annotations

from dataclasses import dataclass

from veilcam_training.job import Settings
from veilcam_training.tables.place import Place


@dataclass(frozen=True)
class Cell:
    """One fit of a table."""

    settings: Settings

    @property
    def place(self) -> Place:
        """Where it stands."""
        return Place.of(self.settings)

    @property
    def name(self) -> str:
        """Of its place and its seed, unless that is 0: no two cells of a table share a name."""
        return self.place.name + (f"_seed{self.settings.seed}" if self.settings.seed else "")
