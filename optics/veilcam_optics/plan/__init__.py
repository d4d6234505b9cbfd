"""Plans: the cheapest way to compute embeddings to within a tolerance, and the reasons."""

from veilcam_optics.plan.planning import Plan, plan

__all__ = ["Plan", "plan"]
