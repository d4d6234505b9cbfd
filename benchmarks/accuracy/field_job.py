"""Job: a free field, 4 mm behind a random pattern of squares lit by a plane wave."""

import math
from functools import cache, partial

import numpy as np
import torch
from torch import Tensor

from benchmarks.accuracy.fresnel import FresnelImpulse, FresnelTransfer
from benchmarks.accuracy.measure import PRECISIONS, Job, Prepared, Setting
from benchmarks.accuracy.rayleigh_sommerfeld import RayleighSommerfeld
from veilcam_optics.propagation import AngularSpectrum, Propagator
from veilcam_optics.propagation.base import complex_type
from veilcam_optics.propagation.sampling import Grid, coverage
from veilcam_optics.transfer.factored import aperture_fields

SQUARES = 10
SIDE = 19e-6
"""Side of a square [m]: no multiple of any sampling pitch, so that its edges fall between."""
DISTANCE = 4e-3
WAVELENGTH = 550e-9
POINTS = 64
PITCH = 6e-6
"""The complex field is wanted at 64 x 64 points, 6 um apart."""

_NODES_PER_SQUARE = 10


class FieldJob:
    """Pattern and truth of the job, and how a field on a finer grid becomes a result.

    Squares of random amplitude and phase have hard edges and fill the whole spectrum. The truth is
    the Rayleigh-Sommerfeld integral (first kind) over every square by Gauss-Legendre quadrature,
    with neither a paraxial approximation nor a sampled source.

    Args:
        quick: fewer settings.
    """

    def __init__(self, *, quick: bool) -> None:
        self.quick = quick
        draw = torch.Generator().manual_seed(2022)
        modulus, turns = torch.rand(2, SQUARES, SQUARES, generator=draw, dtype=torch.float64)
        self.values = torch.polar(modulus, 2 * torch.pi * turns)
        self.reference = cache(self._reference)

    def job(self) -> Job:
        """The job with every setting of ours."""
        settings: list[Setting] = []
        skipped: dict[str, str] = {}
        methods: list[tuple[str, Propagator, dict[str, str]]] = [
            ("angular spectrum", AngularSpectrum(padding="full"), {"padding": "full"}),
            ("angular spectrum", AngularSpectrum(padding="reach"), {"padding": "reach"}),
            (FresnelTransfer.name, FresnelTransfer(), {}),
            (FresnelImpulse.name, FresnelImpulse(), {}),
            (
                RayleighSommerfeld.name,
                RayleighSommerfeld(largest=2**25 if self.quick else 2**29),
                {},
            ),
        ]
        for precision, dtype in PRECISIONS.items():
            for name, propagator, extra in methods:
                for oversampling in (1, 3, 5) if self.quick else (1, 3, 5, 9, 15):
                    support = propagator.supports(
                        self.source(oversampling), self.target(oversampling), DISTANCE, WAVELENGTH
                    )
                    if isinstance(propagator, RayleighSommerfeld) and not support:
                        skipped[f"{name}, oversampling {oversampling}"] = support.reason
                        continue
                    settings.append(
                        Setting(
                            name,
                            {"oversampling": oversampling, **extra, "dtype": precision},
                            partial(self._prepare_grid, propagator, oversampling, dtype),
                            supported=bool(support),
                        )
                    )
            settings.append(
                Setting(
                    "factored field", {"dtype": precision}, partial(self._prepare_factored, dtype)
                )
            )
        title = f"Free field at {DISTANCE * 1e3:g} mm, {POINTS} x {POINTS} points"
        return Job("field", title, self.reference, settings, skipped)

    def target(self, oversampling: int) -> Grid:
        """A grid that holds the wanted points; ``oversampling`` must be odd."""
        return Grid.square(POINTS * oversampling, POINTS * oversampling, PITCH / oversampling)

    def source(self, oversampling: int) -> Grid:
        """The smallest grid around the pattern of the target's pitch, with an even count."""
        pitch = PITCH / oversampling
        count = 2 * math.ceil(SQUARES * SIDE / pitch / 2)
        return Grid.square(count, count, pitch)

    def pattern(self, grid: Grid) -> Tensor:
        """The pattern averaged over the cells of a grid, complex128."""
        edges = (torch.arange(SQUARES + 1, dtype=torch.float64) - SQUARES / 2) * SIDE
        shares = coverage(edges[:-1], edges[1:], grid.rows, float(grid.pitch_y))
        shares = shares.to(torch.complex128)
        return shares.T @ self.values @ shares

    def at_points(self, field: Tensor, oversampling: int) -> Tensor:
        """The wanted points of a field on ``target(oversampling)``."""
        first = (oversampling - 1) // 2
        return field[first::oversampling, first::oversampling]

    def _prepare_grid(
        self, propagator: Propagator, oversampling: int, dtype: torch.dtype
    ) -> Prepared:
        source, target = self.source(oversampling), self.target(oversampling)
        field_type = complex_type(dtype)
        propagate = propagator.prepare(source, target, DISTANCE, WAVELENGTH, dtype=field_type)
        pattern = self.pattern(source).to(field_type)
        return Prepared(lambda: self.at_points(propagate(pattern), oversampling))

    def _prepare_factored(self, dtype: torch.dtype) -> Prepared:
        centres = (torch.arange(SQUARES, dtype=torch.float64) - (SQUARES - 1) / 2) * SIDE
        fields = aperture_fields(
            self.target(1).y(),
            centres,
            SIDE,
            wavelength=WAVELENGTH,
            source_distance=math.inf,
            distance=DISTANCE,
        )
        # The closed form leaves exp(i pi / 4) per axis to the intensity, which forgets it.
        along_y = (fields * -1j).to(complex_type(dtype))
        along_x, values = fields.T.to(complex_type(dtype)), self.values.to(complex_type(dtype))
        return Prepared(lambda: along_y @ values @ along_x)

    def _reference(self) -> Tensor:
        """The Rayleigh-Sommerfeld integral over every square, complex128 (points, points)."""
        nodes, shares = np.polynomial.legendre.leggauss(_NODES_PER_SQUARE)
        centres = (torch.arange(SQUARES, dtype=torch.float64) - (SQUARES - 1) / 2) * SIDE
        within = torch.from_numpy(nodes) * SIDE / 2
        places = (centres[:, None] + within).reshape(-1)
        length = torch.from_numpy(shares).repeat(SQUARES) * SIDE / 2
        spread = torch.kron(self.values, torch.ones(_NODES_PER_SQUARE, _NODES_PER_SQUARE))
        source = spread * length[:, None] * length
        points = self.target(1).y()
        lines = []
        for y in points:
            squared = (y - places).square()[:, None] + (points[:, None, None] - places).square()
            r = (squared + DISTANCE**2).sqrt()
            # r - z without cancellation; the carrier exp(i k z) is left out, as everywhere.
            phase = 2 * torch.pi / WAVELENGTH * squared / (r + DISTANCE)
            kernel = torch.complex(
                DISTANCE / (2 * torch.pi * r**3), -DISTANCE / (WAVELENGTH * r**2)
            ) * torch.polar(torch.ones_like(phase), phase)
            lines.append(torch.einsum("uyx,yx->u", kernel, source))
        return torch.stack(lines)
