"""Effects of the panel: what it shows for a mask, and where it sits."""

from __future__ import annotations

import math
from dataclasses import replace

from veilcam_optics.effects.base import Comparison
from veilcam_optics.effects.light import Probed
from veilcam_optics.effects.model import Model


class Gamma(Probed):
    """The panel's response is a power of what it is told."""

    name = "mask gamma"

    def present(self, model: Model) -> bool:
        """Where it is not 1."""
        return model.conditions.gamma != 1

    def without(self, model: Model) -> Model:
        """A linear panel."""
        return replace(model, conditions=replace(model.conditions, gamma=1.0))

    def reason(self, model: Model) -> str:
        """What half becomes."""
        half = 0.5**model.conditions.gamma
        return f"an amplitude of 0.5 shows as {half:.3g}"

    def absent(self) -> str:
        """Linear."""
        return "linear panel"


class ContrastFloor(Probed):
    """A dark sub-pixel is not quite dark."""

    name = "contrast floor"

    def present(self, model: Model) -> bool:
        """Where a floor is given."""
        return model.conditions.contrast_floor > 0

    def without(self, model: Model) -> Model:
        """Dark is dark."""
        return replace(model, conditions=replace(model.conditions, contrast_floor=0.0))

    def reason(self, model: Model) -> str:
        """Contrast ratio."""
        return f"contrast 1 : {1 / model.conditions.contrast_floor**2:.3g}"

    def absent(self) -> str:
        """None given."""
        return "dark sub-pixels are dark"


class Quantisation(Probed):
    """The panel shows a limited number of amplitudes."""

    name = "mask quantisation"

    def present(self, model: Model) -> bool:
        """Where their number is given."""
        return model.conditions.levels > 0

    def without(self, model: Model) -> Model:
        """Any amplitude can be shown."""
        return replace(model, conditions=replace(model.conditions, levels=0))

    def reason(self, model: Model) -> str:
        """Their number."""
        return f"{model.conditions.levels} amplitudes"

    def absent(self) -> str:
        """Not asked for."""
        return "masks are given as shown"


class MaskShift(Probed):
    """The mask is not centred."""

    name = "mask shift"

    def present(self, model: Model) -> bool:
        """Where a shift is given."""
        return bool(model.conditions.shift_y or model.conditions.shift_x)

    def without(self, model: Model) -> Model:
        """Centred."""
        return replace(model, conditions=replace(model.conditions, shift_y=0.0, shift_x=0.0))

    def reason(self, model: Model) -> str:
        """How far."""
        moved = math.hypot(model.conditions.shift_y, model.conditions.shift_x)
        return f"mask {moved * 1e6:.3g} um off the axis"

    def absent(self) -> str:
        """Centred."""
        return "mask centred"


class MaskRotation(Probed):
    """The mask is turned, so its field no longer separates into rows and columns."""

    name = "mask rotation"
    free = False

    def present(self, model: Model) -> bool:
        """Where an angle is given."""
        return model.conditions.rotation != 0

    def without(self, model: Model) -> Model:
        """Straight."""
        return replace(model, conditions=replace(model.conditions, rotation=0.0))

    def error(self, comparison: Comparison) -> float:
        """Relative L2 at the embedding if it is ignored."""
        return comparison.rotated()

    def reason(self, model: Model) -> str:
        """How far the edge moves."""
        angle, camera = model.conditions.rotation, model.camera
        half = (
            max(
                camera.window.rows * camera.panel.pitch_y,
                camera.window.columns * camera.panel.pitch_x,
            )
            / 2
        )
        moved = abs(angle) * half
        return f"turned by {1e3 * angle:.3g} mrad: its edge moves {moved * 1e6:.3g} um"

    def absent(self) -> str:
        """Straight."""
        return "mask straight"


class DistanceError(Probed):
    """The sensor is not where it should be."""

    name = "distance error"

    def present(self, model: Model) -> bool:
        """Where one is given."""
        return model.conditions.distance_error != 0

    def without(self, model: Model) -> Model:
        """Where it should be."""
        return replace(model, conditions=replace(model.conditions, distance_error=0.0))

    def reason(self, model: Model) -> str:
        """How far off."""
        error, distance = model.conditions.distance_error, model.camera.distance
        return (
            f"sensor {error * 1e6:.3g} um too far, {100 * error / distance:.2g} % of its distance"
        )

    def absent(self) -> str:
        """In place."""
        return "sensor in place"
