"""What accuracy costs in time: every method over its dials, on one job, against one truth."""

from veilcam_optics.accuracy.measure import (
    Job,
    Point,
    Prepared,
    Setting,
    measure,
    pareto_front,
    relative_error,
)

__all__ = [
    "Job",
    "Point",
    "Prepared",
    "Setting",
    "measure",
    "pareto_front",
    "relative_error",
]
