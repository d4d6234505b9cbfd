"""The seam between the engine and where masks come from: stored pairs, or a key.

A source gives, for every epoch, what the panel shows and what reads the embeddings taken behind it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import Receiver
from veilcam_client.wire.captures import Prediction
from veilcam_client.wire.sealing import Release
from veilcam_server.devices.base import Levels, Measurement


@dataclass(frozen=True, slots=True)
class Terms:
    """Terms of an epoch, from its preparation to its end."""

    form: Release
    """In which embeddings leave."""
    receivers: tuple[Receiver, ...] = ()
    """To whom its key is sealed, where the form is ``sealed``."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Evidence of one capture, for the fusion of several; it never leaves the daemon."""

    labels: tuple[str, ...]
    logits: tuple[float, ...] = field(repr=False)
    """Of the classifier, one for each label."""
    light: float = field(repr=False)
    """Mean of the measurement over the mean transmittance of the mask: the same behind each."""
    novelty: float | None = field(repr=False)
    """Root of the normalised innovation squared, over the light in units of that of the mean
    scene: how far the scene is from those to be expected, however bright it is; huge in the dark.
    None where there are no statistics of scenes."""


class Reader(Protocol):
    """Makes sense of embeddings taken behind one mask. It is as secret as the mask."""

    def classify(self, measurement: Measurement) -> Prediction:
        """Return the label of one embedding."""

    def evidence(self, measurement: Measurement) -> Evidence:
        """Return what one embedding tells beside its label."""

    def erase(self) -> None:
        """Overwrite what belongs to the mask alone, as well as Python lets us."""


@dataclass(eq=False, slots=True)
class Mask:
    """Levels for the panel and what reads behind them; they are replaced together."""

    levels: Levels = field(repr=False)
    reader: Reader = field(repr=False)
    mark: str = ""
    """Tells it from the source's other masks, also after a restart, and tells nothing else; empty
    for a mask that never comes again."""
    released: int = 0
    """Embeddings that left behind it, for a mask that never comes again."""

    def erase(self) -> None:
        """Overwrite a mask that never comes again; stored ones stand in their bundle."""
        if not self.mark:
            self.levels.fill(0)
            self.reader.erase()


def transmittance(levels: Levels, steps: int) -> float:
    """Mean share of the light that a mask lets through; a dark one counts as a level's worth.

    Args:
        levels: levels of the mask.
        steps: levels that the panel has.
    """
    weights = levels / (steps - 1)
    return max(float((weights * weights).mean()), 1 / (steps - 1) ** 2)


class MaskSource(Protocol):
    """Source of masks."""

    @property
    def bundle(self) -> str:
        """SHA-256 of the bundle's file, 64 hexadecimal digits."""

    @property
    def renewable(self) -> bool:
        """True where there is another mask to change to."""

    @property
    def marks(self) -> frozenset[str]:
        """Return the levels of all stored masks; none where every mask is new."""

    def make(self, key: EpochKey, avoid: frozenset[str]) -> Mask:
        """Return the mask of an epoch; takes its time, on a thread of its own.

        Args:
            key: key of the epoch, which is erased afterwards.
            avoid: marks of masks that are not returned if there are others.
        """
