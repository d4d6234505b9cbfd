"""Other libraries in the same jobs, where they are installed."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import ModuleType

from veilcam_optics.accuracy import torchoptics_peer, waveprop_peer
from veilcam_optics.accuracy.field_job import FieldJob
from veilcam_optics.accuracy.measure import Setting
from veilcam_optics.accuracy.psf_job import PsfJob
from veilcam_optics.accuracy.transfer_job import TransferJob


@dataclass(frozen=True, slots=True)
class Peer:
    """A library that can do some of the jobs."""

    name: str
    load: Callable[[], ModuleType]
    """Imports what is needed, or raises ImportError."""
    remedy: str
    """How to install it."""
    transfer: Callable[[TransferJob], Iterator[Setting]]
    psf: Callable[[PsfJob], Iterator[Setting]]
    field: Callable[[FieldJob], Iterator[Setting]]

    def missing(self) -> str:
        """Why the library cannot be used, and what to do; empty where it can."""
        try:
            self.load()
        except ImportError as error:
            return f"{type(error).__name__}: {error}: {self.remedy}"
        return ""


PEERS = (
    Peer(
        waveprop_peer.NAME,
        lambda: waveprop_peer.load("slm"),
        "see docs/accuracy.md",
        waveprop_peer.transfer_settings,
        waveprop_peer.psf_settings,
        waveprop_peer.field_settings,
    ),
    Peer(
        torchoptics_peer.NAME,
        lambda: importlib.import_module("torchoptics"),
        "run pip install -e '.[peers]' in the checkout",
        torchoptics_peer.transfer_settings,
        torchoptics_peer.psf_settings,
        torchoptics_peer.field_settings,
    ),
)
"""Every peer; a new one is one more entry."""
