"""Common part of the transfer-function methods: padding, two transforms, and the band limit."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from veilcam_optics.errors import require_memory
from veilcam_optics.propagation.base import TURN, Propagation, check_field, unit_phasor
from veilcam_optics.propagation.sampling import Grid, as_float, fast_length


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """The frequencies of a zero-padded source grid, for one job.

    Attributes:
        source: Sampling of the given field.
        target: Sampling of the wanted field.
        lengths: FFT lengths (rows, columns) after padding.
        device: device of all tensors.
    """

    source: Grid
    target: Grid
    lengths: tuple[int, int]
    device: torch.device | None = None

    def __post_init__(self) -> None:
        rows, columns = self.lengths
        require_memory(
            "grids",
            f"{rows} x {columns}",
            "samples when padded",
            float(rows) * columns,
            "coarser or smaller ones",
        )

    @property
    def fy(self) -> Tensor:
        """Frequencies along y [1/m], shape (lengths[0],), in the order of the FFT."""
        return _frequencies(self.lengths[0], self.device) / self.source.pitch_y

    @property
    def fx(self) -> Tensor:
        """Frequencies along x [1/m], shape (lengths[1],), in the order of the FFT."""
        return _frequencies(self.lengths[1], self.device) / self.source.pitch_x

    def band_limit(self, travel_y: Tensor, travel_x: Tensor) -> Tensor:
        """Return the share of every frequency that is kept, given how far sideways its ray travels.

        The transfer function's phase turns by 2 pi travel / window from one frequency to the next:
        rays that leave the padded window around the target's offset are undersampled and dropped
        (Matsushima and Shimobaba 2009, equation 13; shifted: Matsushima 2010, equation 8). Rays
        that can connect source and target are kept whole. What padding there is in between goes to
        a cosine flank: a sharp edge would ring far into the target.
        """
        share = torch.ones((), dtype=torch.float64, device=travel_y.device)
        source, target = self.source, self.target
        reached = target_samples(source, target)
        for axis, travel in enumerate((travel_y, travel_x)):
            pitch = (source.pitch_y, source.pitch_x)[axis]
            start = (source.centre_y, source.centre_x)[axis]
            end = (target.centre_y, target.centre_x)[axis]
            # The smallest part of a sample keeps a frequency that lies just on the edge.
            half = self.lengths[axis] * pitch / 2 * (1 + 1e-9)
            inner = min(source.shape[axis] + reached[axis], self.lengths[axis] - 1e-3) * pitch / 2
            beyond = ((travel - (end - start)).abs() - inner) / (half - inner)
            share = share * (0.5 + 0.5 * torch.cos(torch.pi * beyond.clamp(0, 1)))
        return share

    def filtered_by(self, transfer: Tensor) -> Propagation:
        """Return the propagation that multiplies the spectrum by ``transfer`` (``lengths``)."""
        source, target, lengths = self.source, self.target, self.lengths
        y, x = source.y(self.device), source.x(self.device)
        v, u = target.y(self.device), target.x(self.device)
        dtype = transfer.dtype
        fits = target.rows <= lengths[0] and target.columns <= lengths[1]
        if fits and same_pitch(source, target):
            # A shift of the window by any length, whole samples or not, is a ramp of phase.
            ramp_y = _ramp(self.fy, v[0] - y[0], dtype)
            ramp_x = _ramp(self.fx, u[0] - x[0], dtype)
            return convolved(source, target, transfer * ramp_y[:, None] * ramp_x)

        # Another pitch: evaluate the Fourier series at the target's points (matrix DFT).
        rows = _ramp(self.fy, v[:, None] - y[0], dtype) / lengths[0]
        columns = _ramp(self.fx, u[:, None] - x[0], dtype) / lengths[1]

        def propagate_scaled(field: Tensor) -> Tensor:
            check_field(field, source, dtype)
            if not field.numel():  # which the FFT refuses
                return field.new_zeros(*field.shape[:-2], *target.shape)
            arrived: Tensor = rows @ (torch.fft.fft2(field, s=lengths) * transfer) @ columns.mT
            return arrived

        return propagate_scaled


def convolved(source: Grid, target: Grid, spectrum: Tensor) -> Propagation:
    """Return the convolution with a kernel of this spectrum, from the first target sample on."""
    lengths = spectrum.shape

    def propagate(field: Tensor) -> Tensor:
        check_field(field, source, spectrum.dtype)
        if not field.numel():  # which the FFT refuses
            return field.new_zeros(*field.shape[:-2], *target.shape)
        arrived: Tensor = torch.fft.ifft2(torch.fft.fft2(field, s=lengths) * spectrum)
        return arrived[..., : target.rows, : target.columns]

    return propagate


def _ramp(frequencies: Tensor, shift: Tensor, dtype: torch.dtype) -> Tensor:
    """Return the phasors that shift a field by any length, one per frequency of the FFT.

    The highest frequency of an even length stands for both signs: it gets the mean of the two
    ramps, or else a field would move differently from its mirror image.
    """
    ramp = unit_phasor(TURN * frequencies * shift, dtype)
    count = len(frequencies)
    highest = torch.arange(count, device=ramp.device) * 2 == count
    return torch.where(highest, ramp.real.to(dtype), ramp)


def full_lengths(source: Grid, target: Grid, guard: float) -> tuple[int, int]:
    """Return FFT lengths with which nothing of the source wraps around into the target.

    The share ``guard`` on top keeps the band limit's sharp edge off the rays to the target's rim.
    """
    rows, columns = target_samples(source, target)
    return (
        fast_length(math.ceil((source.rows + rows) * (1 + guard))),
        fast_length(math.ceil((source.columns + columns) * (1 + guard))),
    )


def target_samples(source: Grid, target: Grid) -> tuple[int, int]:
    """Return how many of the source's samples the target grid is long."""
    return (
        math.ceil(target.height / as_float(source.pitch_y) - 1e-9),
        math.ceil(target.width / as_float(source.pitch_x) - 1e-9),
    )


def same_pitch(source: Grid, target: Grid) -> bool:
    """Return whether both grids have the same pitch, as one variable if it has a gradient."""
    pairs = ((source.pitch_y, target.pitch_y), (source.pitch_x, target.pitch_x))
    return all(a is b or (isinstance(a, float) and a == b) for a, b in pairs)


def _frequencies(length: int, device: torch.device | None) -> Tensor:
    frequencies: Tensor = torch.fft.fftfreq(length, dtype=torch.float64, device=device)
    return frequencies
