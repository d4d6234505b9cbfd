"""One classifier for masks that nobody has used before."""

from veilcam_training.fresh.evaluation import FreshEvaluation, evaluate_fresh
from veilcam_training.fresh.fitting import FreshFit, fit_fresh
from veilcam_training.fresh.job import FreshOutcome, as_fresh_bundle, run_fresh
from veilcam_training.fresh.settings import FreshSettings, find_settings

__all__ = [
    "FreshEvaluation",
    "FreshFit",
    "FreshOutcome",
    "FreshSettings",
    "as_fresh_bundle",
    "evaluate_fresh",
    "find_settings",
    "fit_fresh",
    "run_fresh",
]
