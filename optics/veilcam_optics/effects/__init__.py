"""Everything that light, panel and sensor may do, each one object, all of them in one registry."""

from __future__ import annotations

from veilcam_optics.effects.base import Assessment, Comparison, Effect
from veilcam_optics.effects.light import (
    Binning,
    ColourFilters,
    DeadSpace,
    Depth,
    Diffraction,
    FilterLeakage,
    Interference,
    OffAxis,
    Spectrum,
    SphericalWavefront,
    StrayLight,
)
from veilcam_optics.effects.mask import (
    ContrastFloor,
    DistanceError,
    Gamma,
    MaskRotation,
    MaskShift,
    Quantisation,
)
from veilcam_optics.effects.model import Model, Sampling
from veilcam_optics.effects.sensor import (
    Bayer,
    BlackLevel,
    Converter,
    FullWell,
    ReadNoise,
    ShotNoise,
)

__all__ = ["EFFECTS", "Assessment", "Comparison", "Effect", "Model", "Sampling"]

EFFECTS: tuple[Effect, ...] = (
    Diffraction(),
    SphericalWavefront(),
    DeadSpace(),
    Interference(),
    ColourFilters(),
    FilterLeakage(),
    Spectrum(),
    Depth(),
    OffAxis(),
    Gamma(),
    ContrastFloor(),
    Quantisation(),
    MaskShift(),
    MaskRotation(),
    DistanceError(),
    StrayLight(),
    Binning(),
    Bayer(),
    ShotNoise(),
    ReadNoise(),
    FullWell(),
    Converter(),
    BlackLevel(),
)
"""In the order in which light meets them."""
