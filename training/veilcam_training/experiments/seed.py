"""The seed of a run that was given none: nobody else knows it."""

from __future__ import annotations

import secrets
from pathlib import Path

from veilcam_training.experiments.fit import Settings
from veilcam_training.files import read_private, write_private
from veilcam_training.trainer.distributed import ALONE, Ranks

SEED_BITS = 63


def settle_seed(settings: Settings, work: Path | None, ranks: Ranks = ALONE) -> Settings:
    """``settings`` with the seed that they were given, or else with one that is drawn.

    A mask can be made again by whoever knows its seed, so none is the same for everybody.

    Args:
        settings: of the run.
        work: folder to keep a drawn seed in: the run that is taken up there has it again.
        ranks: processes of the run; all have the seed of the first one.

    Raises:
        TrainingError: the seed in ``work`` is damaged.
    """
    if "seed" in settings.model_fields_set:
        return settings
    return settings.model_copy(update={"seed": ranks.from_first(lambda: _drawn(work))})


def _drawn(work: Path | None) -> int:
    if work is None:
        return secrets.randbits(SEED_BITS)
    path = work / "seed"
    kept = read_private(path)
    if kept is None:
        kept = str(secrets.randbits(SEED_BITS)).encode()
        write_private(path, kept)  # before the fit, which could be killed
    return int(kept)
