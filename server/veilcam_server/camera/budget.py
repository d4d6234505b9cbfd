"""Budget of embeddings that may leave behind one mask over its whole life.

What is sealed is for its receivers, who have the mask anyway. Several raw embeddings behind one
mask give it away, so as many leave as the operator says. For stored masks, which come again, the
number is made durable before an embedding leaves; a mask that is drawn for one showing takes its
number along.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel, ConfigDict, NonNegativeInt

from veilcam_client.wire.sealing import Release
from veilcam_server.errors import ProblemError
from veilcam_server.masks.source import Mask
from veilcam_server.system.state_file import Report, StateStore, log_fault

NAME = "released.json"
"""Of the record in the state directory."""


class _Released(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")
    counts: Mapping[str, NonNegativeInt] = {}
    """Embeddings that left raw, by the mark of their mask."""


class ReleaseBudget:
    """Counts what leaves in the clear. Used by any thread that holds the camera.

    A record that is lost says of no stored mask how much left behind it: all of them are spent from
    then on.

    Args:
        directory: the daemon's state directory, which is held by whoever makes this.
        raw: embeddings that may leave raw behind one mask.
        report: takes what was damaged.

    Raises:
        StartError: the record cannot be read.
    """

    def __init__(self, directory: Path, raw: int, report: Report = log_fault) -> None:
        self._limits: dict[Release, float] = {"sealed": math.inf, "raw": raw}
        self._file = StateStore(
            directory / NAME,
            _Released,
            lost="no embedding leaves raw behind a stored mask any more; to forget what left, move "
            f"{NAME}.lock away",
            report=report,
        )
        self._counts = dict((self._file.read() or _Released()).counts)
        self._lost = self._file.lost

    def refusal(self, mask: Mask, form: Release, *, receives: bool) -> ProblemError | None:
        """Return the reason why no embedding may leave behind a mask; None: one may.

        Args:
            mask: mask that is shown.
            form: form in which embeddings leave behind it.
            receives: True where there is a receiver to whom one is sealed.
        """
        if form == "none":
            return withheld()
        if form == "sealed" and not receives:
            return nobody_receives()
        return masks_spent() if self.is_spent(mask, form) else None

    def is_spent(self, mask: Mask, form: Release) -> bool:
        """Return whether no more embeddings may leave behind ``mask`` in this form."""
        limit = self._limits.get(form, 0)
        if not mask.mark:
            return mask.released >= limit
        return limit < math.inf and (self._lost or self._counts.get(mask.mark, 0) >= limit)

    def spent(self, marks: frozenset[str], form: Release) -> frozenset[str]:
        """Those of stored masks behind which no more embeddings may leave in this form."""
        limit = self._limits.get(form, 0)
        if self._lost and limit < math.inf:
            return marks
        return frozenset(mark for mark in marks if self._counts.get(mark, 0) >= limit)

    def spend(self, mask: Mask, form: Release) -> None:
        """Count one embedding, before it leaves.

        Raises:
            StorageError: that cannot be made durable.
        """
        if not mask.mark:
            mask.released += 1
        elif self._limits[form] < math.inf:
            self._record(mask.mark)

    def _record(self, mark: str) -> None:
        def counted(record: _Released | None) -> _Released:
            counts = dict((record or _Released()).counts)
            # More than either says may have left: a disk that failed half way wrote one of them.
            counts[mark] = max(counts.get(mark, 0), self._counts.get(mark, 0)) + 1
            return _Released(counts=counts)

        self._counts = dict(self._file.change(counted).counts)


def withheld() -> ProblemError:
    """Return the refusal of a daemon that releases no embeddings."""
    return ProblemError(
        "embedding_withheld",
        "this daemon releases no embeddings: ask for a classification, pair a receiver with "
        "'veilcam receiver add', or start it with --release",
    )


def nobody_receives() -> ProblemError:
    """Return the refusal of a sealed embedding that nobody could open."""
    return ProblemError(
        "embedding_withheld",
        "embeddings leave sealed, and no receiver is paired: pair one with 'veilcam receiver add'",
    )


def masks_spent() -> ProblemError:
    """Return the refusal where the budget of all masks is used up."""
    return ProblemError(
        "masks_spent",
        "as many embeddings left behind every mask of this bundle as may: labels go on; install "
        "another bundle for more",
    )
