"""Free-space propagation: one small module per method, behind one interface."""

from veilcam_optics.errors import invalid
from veilcam_optics.propagation.angular_spectrum import AngularSpectrum
from veilcam_optics.propagation.base import Propagation, Propagator, Support
from veilcam_optics.propagation.fraunhofer import Fraunhofer
from veilcam_optics.propagation.fresnel import FresnelImpulse, FresnelTransfer
from veilcam_optics.propagation.geometric import GeometricShadow
from veilcam_optics.propagation.rayleigh_sommerfeld import RayleighSommerfeld

PROPAGATORS: tuple[Propagator, ...] = (
    AngularSpectrum(),
    FresnelTransfer(),
    FresnelImpulse(),
    Fraunhofer(),
    GeometricShadow(),
    RayleighSommerfeld(),
)
"""Every method with its default settings; a new one is one more entry."""


def propagator(name: str) -> Propagator:
    """Return the method called ``name`` with its default settings.

    Raises:
        OpticsError: If there is none of that name; the message lists them all.
    """
    for method in PROPAGATORS:
        if method.name == name:
            return method
    names = ", ".join(repr(method.name) for method in PROPAGATORS)
    raise invalid("name", repr(name), "", f"one of {names}")


__all__ = [
    "PROPAGATORS",
    "AngularSpectrum",
    "Fraunhofer",
    "FresnelImpulse",
    "FresnelTransfer",
    "GeometricShadow",
    "Propagation",
    "Propagator",
    "RayleighSommerfeld",
    "Support",
    "propagator",
]
