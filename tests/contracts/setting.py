"""The circumstances an operator is tested in, and the small camera that they describe."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.propagation.sampling import Real

CPU = torch.device("cpu")
LENGTHS = ("distance", "wavelength", "pitch")

Kind = Literal["weights", "field", "signed"]
"""What an input may hold: [0, 1], complex numbers, or reals of either sign."""


@dataclass(frozen=True)
class Setting:
    """Sizes, types and lengths; the lengths may be tensors that ask for a gradient."""

    rows: int = 5
    columns: int = 4
    dtype: torch.dtype = torch.float64
    device: torch.device = CPU
    distance: float = 1e-3  # [m], of lengths all
    wavelength: float = 550e-9
    pitch: float = 20e-6
    variables: Mapping[str, Tensor] = field(default_factory=dict)

    def length(self, name: str) -> Real:
        if name in self.variables:
            return self.variables[name]
        return {"distance": self.distance, "wavelength": self.wavelength, "pitch": self.pitch}[name]

    @property
    def complex_dtype(self) -> torch.dtype:
        return torch.complex128 if self.dtype == torch.float64 else torch.complex64

    @property
    def mask_shape(self) -> tuple[int, int]:
        return self.rows + 2, self.columns + 1

    def camera(self, *, filters: bool = False, leakage: float = 0.0) -> Camera:
        pitch, wavelength = self.pitch, self.wavelength
        rows, columns = self.mask_shape
        panel = Panel(
            rows=rows,
            columns=columns,
            pitch_y=2 * pitch,
            pitch_x=3 * pitch,
            aperture_y=1.6 * pitch,
            aperture_x=2.5 * pitch,
            filter_cycle=(0, 1, 2) if filters else (),
            filter_leakage=leakage,
        )
        return Camera(
            panel=panel,
            window=Window(rows, columns, 0, 0),
            # Near and odd: neither axis is a whole number of grid samples.
            sensor=Sensor(rows=121, columns=150, pixel=pitch / 12),
            distance=self.distance,
            wavelengths=(1.1 * wavelength, wavelength, 0.9 * wavelength),
        )

    def scene(self) -> Scene:
        distance = 50 * self.distance
        height = 50 * 5 * self.pitch * self.rows / max(self.rows, self.columns)
        return Scene(rows=self.rows, columns=self.columns, height=height, distance=distance)

    def embedding(self) -> Embedding:
        return Embedding(rows=self.columns, columns=self.rows)


@dataclass(frozen=True)
class Bound:
    apply: Callable[[Tensor], Tensor]
    shape: tuple[int, ...]
    result: tuple[int, ...]
    kind: Kind = "weights"

    def sample(self, setting: Setting, seed: int = 0, batch: tuple[int, ...] = ()) -> Tensor:
        generator = torch.Generator().manual_seed(seed)
        shape = (*batch, *self.shape)
        if self.kind == "field":
            values = torch.randn(shape, generator=generator, dtype=torch.complex128)
            return values.to(setting.device, setting.complex_dtype)
        # Away from 0 and 1, so that a small step stays inside.
        values = torch.rand(shape, generator=generator, dtype=torch.float64) * 0.8 + 0.1
        if self.kind == "signed":
            values = 4 * values - 2
        return values.to(setting.device, setting.dtype)


@dataclass(frozen=True)
class Operator:
    name: str
    bind: Callable[[Setting], Bound]
    linear: bool = False
    batched: bool = False
    smooth: bool = True  # the gradient is the derivative
    forward: bool = True  # can be differentiated forward, too
    mirror: tuple[tuple[int, ...], tuple[int, ...]] = ((-2,), (-1,))
    """Axes of the output that mirroring the input's rows, or columns, mirrors."""
    quantities: tuple[str, ...] = ()
    dtypes: tuple[torch.dtype, ...] = (torch.float64, torch.float32)
    meta: bool = False  # works on shapes alone
    refuses: bool = True  # an input of another shape
    random: bool = False
    dark: bool = True  # nothing in, nothing out
    widens: str = ""
    """Why float64 is computed while applying in float32."""


def symmetric_weights(setting: Setting) -> Tensor:
    """A random mask that equals its own mirror image, so that scenes may be mirrored."""
    generator = torch.Generator().manual_seed(5)
    weights = torch.rand(setting.mask_shape, generator=generator, dtype=torch.float64)
    weights = (weights + weights.flip(0)) / 2
    return ((weights + weights.flip(1)) / 2).to(setting.device, setting.dtype)


def centred(count: int, setting: Setting) -> Tensor:
    index = torch.arange(count, dtype=torch.float64, device=setting.device)
    return index - (count - 1) / 2


def measurement_model(conditions: Conditions, *, shot: bool = True) -> Model:
    """The model of a sensor: its measurements do not depend on the light before it."""
    return Model(Camera(), Scene(), Embedding(), conditions, Sampling(shot=shot))
