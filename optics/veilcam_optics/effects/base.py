"""What an effect is, and what it is judged by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from veilcam_optics.effects.model import Model


class Comparison(Protocol):
    """Measures what changing a model does to the embedding; a plan's probe does."""

    @property
    def model(self) -> Model:
        """The model with every effect on."""

    def error(self, changed: Model) -> float:
        """Relative L2 of the transfer when ``changed`` takes the model's place."""

    def rotated(self) -> float:
        """Relative L2 of ignoring the mask's rotation."""

    def off_axis(self, zones: int | None) -> float:
        """Relative L2 with so many zones along each side; None: as if the field were flat."""

    def sampled(self, name: str, count: int) -> float:
        """Relative L2 of ``count`` samples of ``"wavelengths"`` or ``"layers"``."""

    def interference(self) -> float:
        """Relative L2 when no two sub-pixels interfere."""

    def values(self) -> Tensor:
        """Noiseless embeddings of a white scene through each channel, (3, masks, rows, columns).

        Only some rows and columns are there, see :meth:`kept`.
        """

    def kept(self) -> tuple[Tensor, Tensor]:
        """Which embedding rows and columns :meth:`values` holds."""


@dataclass(frozen=True, slots=True)
class Assessment:
    """What one effect does to one camera, scene and embedding.

    Attributes:
        name: of the effect.
        matters: whether it is computed.
        error: relative L2 at the embedding if it were ignored.
        cost_ms: what it adds to a step when it is computed [ms].
        reason: why, in words.
    """

    name: str
    matters: bool
    error: float
    cost_ms: float
    reason: str


class Effect(Protocol):
    """One thing that light, panel or sensor may do. Stateless; all of them are in one registry."""

    @property
    def name(self) -> str:
        """In the field's terms."""

    @property
    def free(self) -> bool:
        """Whether computing it adds (next to) nothing to a step."""

    def present(self, model: Model) -> bool:
        """Whether this camera, scene or these conditions have it at all."""

    def without(self, model: Model) -> Model:
        """The same model with the effect ignored: nothing of it is computed."""

    def error(self, comparison: Comparison) -> float:
        """Relative L2 at the embedding if it is ignored."""

    def reason(self, model: Model) -> str:
        """What makes it large or small here, in words; for a model that has it."""

    def absent(self) -> str:
        """Why a model may not have it, in words."""
