"""Point spread functions of any mask, real or complex, at one wavelength."""

import torch
from torch import Tensor

from veilcam_optics.errors import require
from veilcam_optics.propagation import AngularSpectrum, Propagator
from veilcam_optics.propagation.base import check_field
from veilcam_optics.propagation.illumination import plane_wave, spherical_wave
from veilcam_optics.propagation.sampling import Grid, Real, as_float

AT_INFINITY = float("inf")
_ANGULAR_SPECTRUM = AngularSpectrum()


class PointSpread:
    """The irradiance behind a mask from one point of the scene, at one wavelength.

    Everything that does not depend on the mask is computed once.
    """

    def __init__(
        self,
        source: Grid,
        target: Grid,
        *,
        wavelength: Real,
        distance: Real,
        scene_distance: Real = AT_INFINITY,
        point: tuple[Real, Real] = (0.0, 0.0),
        propagator: Propagator = _ANGULAR_SPECTRUM,
        dtype: torch.dtype = torch.complex128,
        device: torch.device | None = None,
    ) -> None:
        """Prepare illumination and propagation.

        Args:
            source: Sampling of the mask.
            target: Sampling of the irradiance.
            wavelength: [m].
            distance: Mask to sensor [m].
            scene_distance: Scene to mask [m]; infinite for a plane wave along the axis.
            point: (y, x) of the scene point [m].
            propagator: Method of propagation.
            dtype: complex64 or complex128.
            device: device of all tensors.

        Raises:
            OpticsError: If a length has no physical meaning, or a point at infinity is off axis.
        """
        self.source, self.target, self.dtype = source, target, dtype
        if as_float(scene_distance) == AT_INFINITY:
            require(
                all(as_float(offset) == 0 for offset in point),
                "point",
                point,
                "m",
                "(0, 0) at infinity, or a finite scene_distance",
            )
            self._wave = plane_wave(source, wavelength, dtype=dtype, device=device)
        else:
            self._wave = spherical_wave(
                source, scene_distance, wavelength, point=point, dtype=dtype, device=device
            )
        self._to_sensor = propagator.prepare(
            source, target, distance, wavelength, dtype=dtype, device=device
        )

    def field(self, transmittance: Tensor) -> Tensor:
        """Return the complex field at the target, shape (..., rows, columns) of the target."""
        transmittance = transmittance.to(self.dtype)
        check_field(transmittance, self.source, self.dtype)
        return self._to_sensor(transmittance * self._wave)

    def __call__(self, transmittance: Tensor) -> Tensor:
        """Return the irradiance relative to that at the mask, without one.

        Args:
            transmittance: Amplitude or complex transmittance (..., rows, columns) of the source.

        Returns:
            Real, shape (..., rows, columns) of the target; differentiable in ``transmittance``.

        Raises:
            OpticsError: If the shape is not that of the source grid.
        """
        arrived = self.field(transmittance)
        return arrived.real.square() + arrived.imag.square()
