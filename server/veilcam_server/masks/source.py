"""The seam between the engine and where masks come from: stored pairs, or a key.

A source gives, for every epoch, what the panel shows and what reads the embeddings taken behind it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from veilcam_client.wire.captures import Form, Prediction
from veilcam_server.devices.base import Levels, Measurement


class Reader(Protocol):
    """Makes sense of embeddings taken behind one mask. It is as secret as the mask."""

    def classify(self, embedding: Measurement) -> Prediction:
        """Return the label of one embedding."""

    def release(self, embedding: Measurement, form: Form) -> Measurement:
        """Bring one embedding into the form in which it may leave.

        Raises:
            SensorError: the measurement has no such form, for want of light.
        """


@dataclass(frozen=True, eq=False, slots=True)
class Mask:
    """Levels for the panel and what reads behind them; they are replaced together."""

    levels: Levels = field(repr=False)
    reader: Reader = field(repr=False)
    mark: str = ""
    """Tells it from the source's other masks, also after a restart, and tells nothing else; empty
    for a mask that never comes again."""


class MaskSource(Protocol):
    """Where masks come from."""

    @property
    def renewable(self) -> bool:
        """Whether there is another mask to change to."""

    def name(self, counter: int) -> str:
        """Return the name by which the network knows epoch ``counter``: 32 hexadecimal digits."""

    def make(self, counter: int, last_mark: str) -> Mask:
        """Return the mask of epoch ``counter``; takes its time, on a thread of its own.

        Args:
            counter: never used before.
            last_mark: of the mask shown last, which is not returned if there is another.
        """
