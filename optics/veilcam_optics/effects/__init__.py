"""Everything that light, panel and sensor may do, each one object, all of them in one registry."""

from veilcam_optics.effects import light, mask, sensor
from veilcam_optics.effects.base import Assessment, Comparison, Effect
from veilcam_optics.effects.model import Model, Sampling

__all__ = ["EFFECTS", "Assessment", "Comparison", "Effect", "Model", "Sampling"]

EFFECTS: tuple[Effect, ...] = (
    light.Diffraction(),
    light.NonParaxial(),
    light.SphericalWavefront(),
    mask.DeadSpace(),
    light.Interference(),
    mask.ColourFilters(),
    mask.FilterLeakage(),
    light.Spectrum(),
    light.Depth(),
    light.OffAxis(),
    mask.Quantisation(),
    mask.Gamma(),
    mask.ContrastFloor(),
    mask.DeadLines(),
    mask.MaskShift(),
    mask.MaskRotation(),
    mask.DistanceError(),
    light.StrayLight(),
    light.Binning(),
    sensor.Bayer(),
    sensor.ShotNoise(),
    sensor.ReadNoise(),
    sensor.FullWell(),
    sensor.BlackLevel(),
    sensor.Converter(),
)
"""In the order in which they are applied."""
