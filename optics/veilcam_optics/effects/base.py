"""An effect: when it is there, what it does to light and measurements, and its worth."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Protocol

import torch
from torch import Tensor

from veilcam_optics.camera.imperfections import NOMINAL
from veilcam_optics.effects.model import Model
from veilcam_optics.transfer.tables import Beam


class Comparison(Protocol):
    """Measures what changing a model does to the embedding; a plan's probe does."""

    @property
    def model(self) -> Model:
        """The model with every effect on."""

    def error(self, changed: Model) -> float:
        """Relative L2 of the transfer when ``changed`` takes the model's place."""

    def rotated(self) -> float:
        """Relative L2 of ignoring the mask's rotation."""

    def off_axis(self, count: int | None) -> float:
        """Relative L2 with so many zones along each side; None: as if the field were flat."""

    def paraxial(self) -> float:
        """Relative L2 of Fresnel's approximation."""

    def sampled(self, name: str, count: int) -> float:
        """Relative L2 of ``count`` samples of ``"wavelengths"`` or ``"layers"``."""

    def interference(self) -> float:
        """Relative L2 when no two sub-pixels interfere."""

    def white(self) -> Tensor:
        """Noiseless embeddings of a white scene, (masks, rows, columns): some rows and columns."""


@dataclass(frozen=True, slots=True)
class Assessment:
    """Assessment of one effect for one camera, scene and embedding.

    Attributes:
        name: name of the effect.
        matters: True where the effect is computed.
        error: relative L2 at the embedding if it were ignored.
        cost_ms: time that the effect adds to a step when it is computed [ms].
        reason: why, in words.
        present: True where this camera, scene or these conditions have the effect at all.
    """

    name: str
    matters: bool
    error: float
    cost_ms: float
    reason: str
    present: bool = True


class Effect:
    """One thing that light, panel or sensor may do: when it is there, what it does, its worth.

    Stateless. A new one is a class of its own, which says only what it does, and one line in
    :data:`~veilcam_optics.effects.EFFECTS`. What it does is applied where it is present alone.

    Attributes:
        name: name in the field's terms.
        free: True where computing the effect adds (next to) nothing to a step.
        absent: why a model may not have it, in words.
        neutral: conditions, with the values at which the effect is not there.
    """

    name: str
    free = True
    absent = ""
    neutral: Mapping[str, object] = MappingProxyType({})

    def present(self, model: Model) -> bool:
        """Return whether this camera, scene or these conditions have the effect at all."""
        conditions = model.conditions
        return any(getattr(conditions, field) != value for field, value in self.neutral.items())

    def without(self, model: Model) -> Model:
        """Return the same model with the effect ignored: nothing of it is computed."""
        neutral: dict[str, Any] = dict(self.neutral)
        return replace(model, conditions=replace(model.conditions, **neutral))

    def error(self, comparison: Comparison) -> float:
        """Relative L2 at the embedding if it is ignored; by default measured by leaving it out."""
        return comparison.error(self.without(comparison.model))

    def reason(self, model: Model) -> str:
        """Say in words what makes the effect large or small in a model that has it."""
        raise NotImplementedError

    def shown(self, weights: Tensor, model: Model) -> Tensor:  # noqa: ARG002 - part of the interface
        """Return the amplitudes that the panel shows for a mask, same shape."""
        return weights

    def beams(self, beams: list[Beam], model: Model) -> list[Beam]:  # noqa: ARG002 - part of the interface
        """Return the light of each channel with the effect."""
        return beams

    def collected(
        self,
        values: Tensor,
        axes: tuple[int, ...],  # noqa: ARG002 - part of the interface
        model: Model,  # noqa: ARG002 - part of the interface
    ) -> Tensor:
        """Return the light on the sensor; embedding pixels run along ``axes``. Linear."""
        return values

    def electrons(
        self,
        electrons: Tensor,
        model: Model,  # noqa: ARG002 - part of the interface
        generator: torch.Generator | None,  # noqa: ARG002 - part of the interface
    ) -> Tensor:
        """Return the electrons that a pixel reads, where electrons are counted."""
        return electrons

    def measurement(
        self,
        values: Tensor,
        model: Model,  # noqa: ARG002 - part of the interface
        generator: torch.Generator | None,  # noqa: ARG002 - part of the interface
    ) -> Tensor:
        """Return the embedding values that the camera reads, after the electrons."""
        return values


class Imperfection(Effect):
    """An effect of how the camera was built.

    Attributes:
        fields: fields of :class:`~veilcam_optics.camera.imperfections.Imperfections` that it owns.
    """

    fields: tuple[str, ...]

    def present(self, model: Model) -> bool:
        """Return whether one of its fields is not nominal."""
        imperfections = model.conditions.imperfections
        return any(getattr(imperfections, name) != getattr(NOMINAL, name) for name in self.fields)

    def without(self, model: Model) -> Model:
        """Return the same model, nominal in its fields."""
        conditions = model.conditions
        nominal: dict[str, Any] = {name: getattr(NOMINAL, name) for name in self.fields}
        imperfections = replace(conditions.imperfections, **nominal)
        return replace(model, conditions=replace(conditions, imperfections=imperfections))

    def shown(self, weights: Tensor, model: Model) -> Tensor:
        """Return the amplitudes of a panel that is nominal in everything else."""
        imperfections = model.conditions.imperfections
        own: dict[str, Any] = {name: getattr(imperfections, name) for name in self.fields}
        return replace(NOMINAL, **own).shown(weights)
