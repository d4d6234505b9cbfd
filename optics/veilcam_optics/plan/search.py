"""The cheapest setting whose errors, taken together, stay under the tolerance."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import torch

from veilcam_optics import effects
from veilcam_optics.effects import Effect, Model
from veilcam_optics.effects.light import Depth, Diffraction, NonParaxial, OffAxis, Spectrum
from veilcam_optics.effects.mask import FilterLeakage, MaskRotation
from veilcam_optics.effects.model import Method
from veilcam_optics.effects.sensor import Bayer
from veilcam_optics.plan.cost import Cost, cost, pairs
from veilcam_optics.plan.errors import ErrorModel, Interferences
from veilcam_optics.plan.grids import OVERSAMPLINGS
from veilcam_optics.transfer.grid import FEWEST_CELLS, cells_in_aperture

MAX_NUMBERS = 1.5e8
"""Numbers that a plan may hold at once: 600 MB in float32."""

SPARE = 0.1
"""A free effect is on if ignoring it would take more than this share of the tolerance."""

_ABOUT = 1.1
"""Where the tolerance is out of reach, errors this close to the least are as good."""

_SAMPLES = (2, 3, 5)
_ZONES = (1, 2, 3, 5, 7)


@dataclass(frozen=True, slots=True)
class Option:
    """One way of sampling one thing: how it changes a model, and the error it leaves."""

    change: Callable[[Model], Model]
    error: float


@dataclass(frozen=True, slots=True)
class Candidate:
    """A setting, its predicted relative L2 error at the embedding, and its cost."""

    model: Model
    error: float
    cost: Cost


def together(errors: Iterable[float]) -> float:
    """Errors of different origin are uncorrelated: they add up in quadrature."""
    return math.sqrt(sum(error * error for error in errors))


def settle_free(model: Model, errors: Mapping[str, float], tolerance: float) -> tuple[Model, float]:
    """Switch off every free effect that hardly shows; return what is left, and the error made."""
    ignored = []
    for effect in effects.EFFECTS:
        if effect.free and effect.name in errors and errors[effect.name] <= SPARE * tolerance:
            model = effect.without(model)
            ignored.append(errors[effect.name])
    return model, together(ignored)


def search(
    error_model: ErrorModel,
    model: Model,
    errors: Mapping[str, float],
    tolerance: float,
    *,
    made: float,
    batch: int,
    method: Method | None = None,
) -> tuple[Candidate, bool]:
    """Find the cheapest candidate within tolerance and memory, and say whether there is one.

    Args:
        error_model: knows the errors of the sampling.
        model: model with the free effects settled.
        errors: error of every effect that is there, if it were ignored.
        tolerance: relative L2.
        made: error of the free effects that were switched off.
        batch: scenes in a step.
        method: the only one to choose from; None for all.

    Returns:
        The choice, and whether it reaches the tolerance; if none does, the most accurate.
    """
    field = _field(error_model, model, errors, tolerance)
    settings: list[tuple[Model, float]] = []
    found: list[Candidate] = []

    def look_at(kind: Iterable[tuple[Model, float]]) -> None:
        more = [(setting, together([made, error])) for setting, error in kind]
        settings.extend(more)
        reaching = [(m, e) for m, e in more if error_model.read(e) <= tolerance]
        found.extend(_fitting(reaching, batch, method))

    if method != "grid":
        look_at(_matrices(error_model, model, errors, field, tolerance))
    if method in (None, "grid"):
        # Grids are judged by being used, which takes a while: only those that would be faster are.
        below = min((candidate.cost.rank for candidate in found), default=math.inf)
        look_at(_grids(error_model, model, field, batch, below))
    if found:
        return min(found, key=lambda c: (c.cost.rank, c.error)), True
    # Nothing reaches it: the cheapest of those that fit and are about as accurate as any.
    found = _fitting(settings, batch, method)
    if found:
        least = min(candidate.error for candidate in found)
        found = [candidate for candidate in found if candidate.error <= _ABOUT * least]
        return min(found, key=lambda c: c.cost.rank), False
    return min(_candidates(settings, batch, method), key=lambda c: c.cost.numbers), False


def _fitting(
    settings: list[tuple[Model, float]], batch: int, method: Method | None
) -> list[Candidate]:
    return [c for c in _candidates(settings, batch, method) if c.cost.numbers <= MAX_NUMBERS]


def _candidates(
    settings: list[tuple[Model, float]], batch: int, method: Method | None
) -> Iterator[Candidate]:
    for model, error in settings:
        if method in (None, model.sampling.method):
            yield Candidate(model, error, cost(model, batch))
        if model.sampling.method == "transfer" and method != "transfer":
            factors = replace(model, sampling=replace(model.sampling, method="factors"))
            yield Candidate(factors, error, cost(factors, batch))


def _matrices(
    error_model: ErrorModel,
    model: Model,
    errors: Mapping[str, float],
    field: Sequence[list[Option]],
    tolerance: float,
) -> Iterator[tuple[Model, float]]:
    """Yield settings of the factored field, with or without a matrix that is formed."""
    filters = [(model, 0.0, error_model.full)]
    if FilterLeakage.name in errors:
        ideal = FilterLeakage().without(model)
        filters.append((ideal, errors[FilterLeakage.name], error_model.ideal_filters))
    paraxial = errors.get(NonParaxial.name, 0.0)
    if MaskRotation.name in errors:
        ignored = Option(MaskRotation().without, errors[MaskRotation.name])
        field = [*field, [ignored, Option(_same, error_model.rotated(first_order=True))]]
    for base, leaked, interferences in filters:
        reaches = _reaches(base, interferences, errors, tolerance)
        for chosen in product(reaches, *field, _formats(error_model, tolerance)):
            yield _apply(base, together([leaked, paraxial]), chosen)


def _grids(
    error_model: ErrorModel,
    model: Model,
    field: Sequence[list[Option]],
    batch: int,
    below: float,
) -> Iterator[tuple[Model, float]]:
    """Yield settings of the grid path that rank below a cost."""
    sampling = replace(
        model.sampling, method="grid", diffraction=True, spherical=True, binning=True
    )
    # Narrow apertures need finer samples from the start.
    least = max(1.0, FEWEST_CELLS / cells_in_aperture(model.camera))
    grids = error_model.grids(replace(model, sampling=sampling), least)
    for factor in OVERSAMPLINGS:
        oversampling = factor * least
        base = replace(model, sampling=replace(sampling, oversampling=oversampling))
        if cost(base, batch).rank >= below:
            break
        error = together([grids.at(oversampling), error_model.off_grid()])
        for chosen in product(*field):
            yield _apply(base, error, chosen)


def _apply(base: Model, error: float, chosen: Iterable[Option]) -> tuple[Model, float]:
    """Return a model with options chosen, and the error they leave together."""
    errors = [error]
    for option in chosen:
        base = option.change(base)
        errors.append(option.error)
    return base, together(errors)


def _same(model: Model) -> Model:
    return model


def _worth_it(options: list[Option], tolerance: float) -> list[Option]:
    """Sort from coarse to fine, without options that are too coarse or needlessly fine."""
    enough = next((k for k, o in enumerate(options) if o.error <= 0.02 * tolerance), len(options))
    options = options[: enough + 1]
    return [o for o in options if o.error <= tolerance] or [min(options, key=lambda o: o.error)]


def _reaches(
    base: Model, interferences: Interferences, errors: Mapping[str, float], tolerance: float
) -> list[Option]:
    """Shadows, and every reach that no other beats in both accuracy and number of pairs."""
    options = [Option(Diffraction().without, errors[Diffraction.name])]
    if not interferences.model.sampling.diffraction:
        return options
    by_work = []
    for reach, error in interferences.errors.items():
        by_work.append((pairs(base.with_sampling(reach=reach)), error, reach))
    least = math.inf
    for _, error, reach in sorted(by_work, key=lambda item: (item[0], item[1])):
        if error < least:
            least = error
            options.append(Option(partial(Model.with_sampling, reach=reach), error))
    return _worth_it(options, tolerance)


def _field(
    error_model: ErrorModel, model: Model, errors: Mapping[str, float], tolerance: float
) -> list[list[Option]]:
    """Options of spectrum, depth, field of view and Bayer pattern, each left out or sampled."""
    sampling = []
    effect: Effect
    for effect, name, counts in (
        (Spectrum(), "wavelengths", _SAMPLES),
        (Depth(), "layers", _SAMPLES),
        (OffAxis(), "zones", _ZONES),
    ):
        if effect.name not in errors:
            continue
        options = [Option(effect.without, errors[effect.name])]
        for count in counts:
            if options[-1].error <= 0.02 * tolerance:
                break  # finer is needlessly fine
            if name == "zones" and count > max(model.scene.shape):
                break
            left = (
                error_model.off_axis(count) if name == "zones" else error_model.sampled(name, count)
            )
            options.append(Option(partial(Model.with_samples, of=name, count=count), left))
        sampling.append(_worth_it(options, tolerance))
    if Bayer.name in errors:
        options = [Option(Bayer().without, errors[Bayer.name]), Option(_same, 0.0)]
        sampling.append(_worth_it(options, tolerance))
    return sampling


def _formats(error_model: ErrorModel, tolerance: float) -> list[Option]:
    """List number formats, with the accuracy that rounding costs."""
    options = [
        Option(partial(Model.with_sampling, dtype=dtype), error_model.rounding(dtype))
        for dtype in (torch.float32, torch.float64)
    ]
    return _worth_it(options, tolerance)
