"""The cheapest setting whose errors, taken together, stay under the tolerance."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import torch

from veilcam_optics.effects import Effect, Model
from veilcam_optics.effects.light import Depth, Diffraction, NonParaxial, OffAxis, Spectrum
from veilcam_optics.effects.mask import FilterLeakage, MaskRotation
from veilcam_optics.effects.model import Method
from veilcam_optics.effects.sensor import Bayer
from veilcam_optics.plan.bounds import QUADRATURE, fringe_step
from veilcam_optics.plan.cost import Cost, cost, pairs
from veilcam_optics.plan.errors import ErrorModel, Interferences
from veilcam_optics.plan.grids import OVERSAMPLINGS
from veilcam_optics.transfer.grid import FEWEST_CELLS, cells_in_aperture
from veilcam_optics.transfer.tables import Reach

MAX_NUMBERS = 1.5e8
"""Numbers that a plan may hold at once: 600 MB in float32."""

_ABOUT = 1.25
"""Where the tolerance is out of reach, errors this close to the least are as good."""

_NEAR, _SAME, _BUILD_MS = 1.05, 1.01, 2000.0
"""Steps, over the cheapest, among which accuracy decides; steps that are taken for the same; and
the time of making an operator that is not minded [ms]."""

_BETTER = 0.95
"""An error this much smaller is worth what is near in cost."""

_FARTHEST = 10.0
"""Settings whose error is so many times the tolerance are not looked at where better ones are."""

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


@dataclass(frozen=True, slots=True)
class Choice:
    """A chosen setting, and its neighbours among the settings that no other beats.

    Attributes:
        best: the setting.
        reached: True where its error is within the tolerance.
        coarser: next setting that is cheaper and less accurate, if there is one.
        finer: next setting that is dearer and more accurate, if there is one.
    """

    best: Candidate
    reached: bool
    coarser: Candidate | None
    finer: Candidate | None


def search(
    error_model: ErrorModel,
    errors: Mapping[str, float],
    tolerance: float,
    *,
    batch: int,
    method: Method | None = None,
) -> Choice:
    """Find the cheapest setting within tolerance and memory; if none is, the most accurate.

    Of settings that cost about the same the most accurate is taken.

    Args:
        error_model: knows the errors of the sampling.
        errors: error of every effect that is there, if it were ignored.
        tolerance: relative L2.
        batch: scenes in a step.
        method: the only one to choose from; None for all.
    """
    model = error_model.model
    field = _field(error_model, model, errors, tolerance)
    found: list[Candidate] = []
    if method != "grid":
        settings = list(_matrices(error_model, model, errors, field, tolerance))
        found = _candidates(settings, batch, method, _FARTHEST * tolerance)
    if method == "grid" or (method is None and not (found and error_model.late)):
        # Grids are judged by being used, which takes a while: only those that would be faster are.
        reaching = [c.cost.rank for c in _fitting(found) if error_model.read(c.error) <= tolerance]
        below = min(reaching, default=math.inf)
        settings = list(_grids(error_model, model, field, batch, below))
        found += _candidates(settings, batch, method, math.inf)
    fitting = _fitting(found)
    if not fitting:
        return Choice(min(found, key=lambda c: c.cost.numbers), False, None, None)
    reaching_ = [c for c in fitting if error_model.read(c.error) <= tolerance]
    least = _ABOUT * min(c.error for c in fitting)
    best = _best(reaching_ or [c for c in fitting if c.error <= least])
    return Choice(best, bool(reaching_), _coarser(fitting, best), _finer(fitting, best))


def _best(candidates: list[Candidate]) -> Candidate:
    """Return the cheapest candidate, or one near it in cost that is more accurate."""
    ordered = sorted(candidates, key=lambda c: (c.cost.rank, c.error))
    best = ordered[0]
    step, build = _NEAR * best.cost.step_ms, best.cost.build_ms + _BUILD_MS
    for other in ordered:
        if other.cost.step_ms > step or other.cost.build_ms > build:
            continue
        same = other.cost.step_ms <= _SAME * best.cost.step_ms and other.error < best.error
        if same or other.error < _BETTER * best.error:
            best = other
    return best


def _coarser(candidates: list[Candidate], best: Candidate) -> Candidate | None:
    """Return the most accurate candidate that costs less, if it is less accurate."""
    cheaper = [c for c in candidates if c.cost.step_ms < best.cost.step_ms / _NEAR]
    return min(cheaper, key=lambda c: (c.error, c.cost.rank), default=None)


def _finer(candidates: list[Candidate], best: Candidate) -> Candidate | None:
    """Return the cheapest candidate that is more accurate."""
    better = [c for c in candidates if c.error < _BETTER * best.error]
    return min(better, key=lambda c: (c.cost.rank, c.error), default=None)


def _fitting(candidates: list[Candidate]) -> list[Candidate]:
    return [c for c in candidates if c.cost.numbers <= MAX_NUMBERS]


def _candidates(
    settings: list[tuple[Model, float]], batch: int, method: Method | None, most: float
) -> list[Candidate]:
    """Candidates of settings, by every method; those with errors above ``most`` where none is."""
    most = max(most, min((error for _, error in settings), default=0.0))
    found = []
    for model, error in settings:
        if error > most:
            continue
        methods: tuple[Method, ...] = ("transfer", "factors")
        for one in (model.sampling.method,) if model.sampling.method == "grid" else methods:
            if method in (None, one):
                by_method = replace(model, sampling=replace(model.sampling, method=one))
                found.append(Candidate(by_method, error, cost(by_method, batch)))
    return found


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
        quadrature = QUADRATURE if base.sampling.diffraction else 0.0
        for chosen in product(reaches, *field, _formats(error_model, tolerance)):
            yield _apply(base, together([leaked, paraxial, quadrature]), chosen)


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


def _with_reach(model: Model, reach: Reach) -> Model:
    return model.with_sampling(reach=reach, step=fringe_step(model, reach))


def _same(model: Model) -> Model:
    return model


def _worth_it(options: list[Option], tolerance: float) -> list[Option]:
    """Options from coarse to fine: those that will do, and one to either side."""
    enough = next((k for k, o in enumerate(options) if o.error <= 0.02 * tolerance), len(options))
    options = options[: enough + 2]
    first = next((k for k, o in enumerate(options) if o.error <= tolerance), len(options) - 1)
    return options[max(0, first - 1) :]


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
            change = partial(_with_reach, reach=reach)
            options.append(Option(change, error))
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
        # Fading takes no time: the field's angle is left out of no setting.
        options = [] if name == "zones" else [Option(effect.without, errors[effect.name])]
        for count in counts:
            if options and options[-1].error <= 0.02 * tolerance:
                break  # finer is needlessly fine
            if (name == "zones" and count > max(model.scene.shape)) or (
                options and error_model.late
            ):
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
