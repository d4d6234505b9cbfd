"""Jobs, the settings that may do them, and what one setting costs and misses."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.camera.masks import random_mask
from veilcam_optics.errors import require_count, require_positive

OURS = "veilcam"
PRECISIONS = {"float32": torch.float32, "float64": torch.float64}

Psf = Callable[[Tensor], Tensor]
"""From weights to the irradiance (3, rows, columns)."""


def example_mask(camera: Camera) -> Tensor:
    """The mask that the jobs use: uniform random, float64, always the same."""
    return random_mask(camera, torch.Generator().manual_seed(2022)).double()


@dataclass(frozen=True, slots=True)
class Prepared:
    """A setting once everything that does not depend on the mask or field is computed."""

    run: Callable[[], object]
    """What is timed."""
    result: Callable[[], Tensor] | None = None
    """What is compared with the reference; None where ``run`` returns just that."""

    def compared(self) -> Tensor:
        """The result, in the form and on the samples of the reference."""
        value = self.run() if self.result is None else self.result()
        if not isinstance(value, Tensor):
            raise TypeError(f"a setting's result is {type(value).__name__}, not a tensor")
        return value


@dataclass(frozen=True, slots=True)
class Method:
    """One method with all its dials set."""

    method: str
    dials: Mapping[str, str | int | float]

    @property
    def label(self) -> str:
        """Method and dials in words."""
        dials = ", ".join(f"{name} {value}" for name, value in self.dials.items())
        return f"{self.method} ({dials})" if dials else self.method


@dataclass(frozen=True, slots=True)
class Setting(Method):
    """How a method is made ready and compared."""

    prepare: Callable[[], Prepared]
    source: str = OURS
    """Which library: ``veilcam``, or the name of a peer."""
    supported: bool = True
    """Whether the method itself says that it is accurate here."""
    free_factor: bool = False
    """Compare up to one constant: for libraries with a unit or a carrier phase of their own."""
    reference: Callable[[], Tensor] | None = None
    """Truth for a geometry that only this setting has; None: the job's."""


@dataclass(frozen=True, slots=True)
class Job:
    """One thing to compute, and every setting that can."""

    name: str
    title: str
    reference: Callable[[], Tensor]
    settings: Sequence[Setting]
    skipped: Mapping[str, str] = field(default_factory=dict)
    """Methods that cannot do this job at all, and why."""


@dataclass(frozen=True, slots=True)
class Point(Method):
    """What one setting was measured to miss and to cost."""

    source: str
    supported: bool
    error: float
    """Relative L2 distance to the reference."""
    seconds: float
    """Median time of one run."""
    fastest_seconds: float
    prepare_seconds: float
    """Time of what is computed once per geometry."""
    runs: int


def relative_error(value: Tensor, reference: Tensor, *, free_factor: bool = False) -> float:
    """Relative L2 distance, in double precision.

    Args:
        value: what a method gave, of the reference's shape.
        reference: the truth.
        free_factor: scale ``value`` by the constant that brings it nearest to the reference first.

    Raises:
        ValueError: the shapes differ, or the reference is zero.
    """
    if value.shape != reference.shape:
        raise ValueError(f"result has shape {tuple(value.shape)}, not {tuple(reference.shape)}")
    wide = torch.complex128 if reference.is_complex() or value.is_complex() else torch.float64
    found, truth = value.to(wide).flatten(), reference.to(wide).flatten()
    size = float(truth.norm())
    if size == 0:
        raise ValueError("the reference is zero everywhere: no relative error exists")
    if free_factor:
        power = torch.vdot(found, found)
        if float(power.abs()) > 0:
            found = found * (torch.vdot(found, truth) / power)
    return float((found - truth).norm()) / size


def measure(
    setting: Setting, reference: Tensor, *, least: int = 3, budget: float = 1.0, most: int = 200
) -> Point:
    """Prepare a setting, compare its result, then time it.

    Args:
        setting: method and dials.
        reference: the job's truth, used unless the setting brings its own.
        least: runs to time at least.
        budget: time to spend on further runs [s].
        most: runs to time at most.
    """
    require_count("least", least)
    require_positive("budget", budget, "s")
    with torch.no_grad():
        started = time.perf_counter()
        prepared = setting.prepare()
        prepare_seconds = time.perf_counter() - started
        truth = reference if setting.reference is None else setting.reference()
        error = relative_error(prepared.compared(), truth, free_factor=setting.free_factor)
        if prepared.result is not None:
            prepared.run()  # else the comparison has warmed caches and FFT plans
        times: list[float] = []
        while len(times) < least or (sum(times) < budget and len(times) < most):
            started = time.perf_counter()
            prepared.run()
            times.append(time.perf_counter() - started)
    return Point(
        method=setting.method,
        dials=setting.dials,
        source=setting.source,
        supported=setting.supported,
        error=error,
        seconds=statistics.median(times),
        fastest_seconds=min(times),
        prepare_seconds=prepare_seconds,
        runs=len(times),
    )


def pareto_front(points: Sequence[Point]) -> list[Point]:
    """The points that none beats in both time and error, fastest first."""
    front: list[Point] = []
    for point in sorted(points, key=lambda p: (p.seconds, p.error)):
        if not front or point.error < front[-1].error:
            front.append(point)
    return front
