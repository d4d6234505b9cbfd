"""What the planner chooses for a tolerance, as settings in the transfer job."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import torch

from veilcam_optics.plan import plan
from veilcam_optics.work_precision.measure import Prepared, Setting
from veilcam_optics.work_precision.transfer_job import TransferJob

METHOD = "plan"
TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4)


def plan_settings(job: TransferJob) -> Iterator[Setting]:
    """One setting for each tolerance: planning and building are set-up, only the run is timed."""
    for tolerance in TOLERANCES:
        yield Setting(METHOD, {"tolerance": f"{tolerance:.0e}"}, partial(_prepare, job, tolerance))


def _prepare(job: TransferJob, tolerance: float) -> Prepared:
    chosen = plan(job.camera, job.scene, job.embedding, tolerance)
    operator = chosen.operator
    weights = job.weights.to(chosen.model.dials.dtype)
    if operator.has_transfer:
        return Prepared(lambda: operator(weights))
    # A way that forms no matrix shows it one scene pixel at a time.
    pixels = job.scene.rows * job.scene.columns
    units = torch.eye(pixels, dtype=weights.dtype).reshape(pixels, *job.scene.shape)
    return Prepared(lambda: operator.embed(units, weights).flatten(1))
