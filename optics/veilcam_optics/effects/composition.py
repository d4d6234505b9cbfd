"""All effects of a model together, stage by stage; each acts only where it is present."""

from functools import lru_cache

import torch
from torch import Tensor

from veilcam_optics import effects
from veilcam_optics.effects.base import Effect
from veilcam_optics.effects.light import Zone
from veilcam_optics.effects.model import Model
from veilcam_optics.transfer.tables import Beam


def present(model: Model) -> tuple[Effect, ...]:
    """List the effects that a model has."""
    return _present(model, effects.EFFECTS)


@lru_cache(maxsize=64)
def _present(model: Model, every: tuple[Effect, ...]) -> tuple[Effect, ...]:
    """Cache the effects of the few models that a plan asks for again and again."""
    return tuple(effect for effect in every if effect.present(model))


def beams(model: Model, zone: Zone | None = None) -> tuple[Beam, ...]:
    """List the beams of each channel: samples of its spectrum times samples of the depth."""
    return _beams(model, (1.0, 1.0) if zone is None else zone.stretch, present(model))


@lru_cache(maxsize=64)
def _beams(
    model: Model, stretch: tuple[float, float], there: tuple[Effect, ...]
) -> tuple[Beam, ...]:
    wavelengths = enumerate(model.camera.wavelengths)
    found = [Beam(channel, wavelength, stretch=stretch) for channel, wavelength in wavelengths]
    for effect in there:
        found = effect.beams(found, model)
    return tuple(found)


def shown(model: Model, weights: Tensor) -> Tensor:
    """Amplitudes that the panel shows when it is told ``weights``, same shape."""
    for effect in present(model):
        weights = effect.shown(weights, model)
    return weights


def collected(model: Model, values: Tensor, axes: tuple[int, ...]) -> Tensor:
    """Return the light on the sensor; embedding pixels run along ``axes`` of ``values``."""
    for effect in present(model):
        values = effect.collected(values, axes, model)
    return values


def read(model: Model, values: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Return the camera's reading of noiseless embeddings.

    Counting and rounding pass the gradient of the identity on (straight-through).

    Args:
        model: gives noise, saturation, converter and offset.
        values: noiseless embeddings, (batch, ...), not negative.
        generator: source of the random numbers.

    Returns:
        Measurements in the unit of ``values``, same shape.
    """
    scale = model.conditions.electrons
    if scale:
        electrons = values * scale
        for effect in present(model):
            electrons = effect.electrons(electrons, model, generator)
        values = electrons / scale
    for effect in present(model):
        values = effect.measurement(values, model, generator)
    return values
