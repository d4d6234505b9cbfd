"""Free-space propagation of complex fields."""

from veilcam_optics.propagation.angular_spectrum import AngularSpectrum
from veilcam_optics.propagation.base import Propagation, Propagator, Support

__all__ = ["AngularSpectrum", "Propagation", "Propagator", "Support"]
