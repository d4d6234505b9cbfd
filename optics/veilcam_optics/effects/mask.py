"""Effects of the panel: its structure, what it shows for a mask, and where it sits."""

import math
from dataclasses import replace
from types import MappingProxyType

from torch import Tensor

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.camera.masks import quantise
from veilcam_optics.effects.base import Comparison, Effect, Imperfection
from veilcam_optics.effects.model import Model


class DeadSpace(Effect):
    """Wiring between the sub-pixels lets no light through."""

    name = "dead space"
    absent = "apertures as wide as their pitch"

    def present(self, model: Model) -> bool:
        """Return whether apertures are smaller than their pitch."""
        panel = model.camera.panel
        return panel.aperture_y < panel.pitch_y or panel.aperture_x < panel.pitch_x

    def without(self, model: Model) -> Model:
        """Apertures as wide as their pitch."""
        panel = model.camera.panel
        panel = replace(panel, aperture_y=panel.pitch_y, aperture_x=panel.pitch_x)
        return replace(model, camera=replace(model.camera, panel=panel))

    def reason(self, model: Model) -> str:
        """Open share of the area."""
        panel = model.camera.panel
        fill = panel.aperture_y * panel.aperture_x / (panel.pitch_y * panel.pitch_x)
        return f"only {100 * fill:.3g} % of the panel's area is open"


class ColourFilters(Effect):
    """Every sub-pixel row passes one colour."""

    name = "colour filters"
    absent = "panel without filters"

    def present(self, model: Model) -> bool:
        """Return whether the panel has colour filters."""
        return bool(model.camera.panel.filter_cycle)

    def without(self, model: Model) -> Model:
        """All rows pass all light."""
        panel = replace(model.camera.panel, filter_cycle=(), filter_amplitudes=())
        return replace(model, camera=replace(model.camera, panel=panel))

    def reason(self, model: Model) -> str:
        """Colours apart."""
        cycle = "".join("RGB"[channel] for channel in model.camera.panel.filter_cycle)
        return f"rows pass {cycle} in turn"


class FilterLeakage(Effect):
    """A filter passes some light of the other colours: leakage, or measured amplitudes."""

    name = "filter leakage"
    free = False
    absent = "no filters, or ideal ones"

    def present(self, model: Model) -> bool:
        """Return whether the panel has filters that are not ideal."""
        panel = model.camera.panel
        return bool(panel.filter_cycle) and bool(panel.filter_leakage or panel.filter_amplitudes)

    def without(self, model: Model) -> Model:
        """Ideal filters."""
        panel = replace(model.camera.panel, filter_leakage=0.0, filter_amplitudes=())
        return replace(model, camera=replace(model.camera, panel=panel))

    def reason(self, model: Model) -> str:
        """Power that leaks."""
        panel = model.camera.panel
        if panel.filter_amplitudes:
            return "measured amplitudes of every filter for every channel"
        return f"foreign light passes with {100 * panel.filter_leakage**2:.2g} % of its power"


class Quantisation(Effect):
    """The panel shows a limited number of amplitudes."""

    name = "mask quantisation"
    absent = "masks are given as shown"
    neutral = MappingProxyType({"levels": 0})

    def reason(self, model: Model) -> str:
        """Their number."""
        return f"{model.conditions.levels} amplitudes"

    def shown(self, weights: Tensor, model: Model) -> Tensor:
        """Round, with the gradient of the identity."""
        return quantise(weights, replace(model.camera.panel, levels=model.conditions.levels))


class Gamma(Imperfection):
    """The panel's response is a power of what it is told."""

    name = "mask gamma"
    absent = "linear panel"
    fields = ("gamma",)

    def reason(self, model: Model) -> str:
        """Say what half a weight becomes."""
        half = 0.5**model.conditions.imperfections.gamma
        return f"an amplitude of 0.5 shows as {half:.3g}"


class ContrastFloor(Imperfection):
    """A dark sub-pixel is not quite dark."""

    name = "contrast floor"
    absent = "dark sub-pixels are dark"
    fields = ("contrast_floor",)

    def reason(self, model: Model) -> str:
        """Contrast ratio."""
        return f"contrast 1 : {1 / model.conditions.imperfections.contrast_floor**2:.3g}"


class DeadLines(Imperfection):
    """Rows and columns of the mask do not obey."""

    name = "dead lines"
    absent = "every line obeys"
    fields = ("dead_rows", "dead_columns", "dead_transmittance")

    def present(self, model: Model) -> bool:
        """Return whether there are dead lines."""
        imperfections = model.conditions.imperfections
        return bool(imperfections.dead_rows or imperfections.dead_columns)

    def reason(self, model: Model) -> str:
        """Say how many lines are dead, and what they pass."""
        imperfections = model.conditions.imperfections
        rows, columns = len(imperfections.dead_rows), len(imperfections.dead_columns)
        passed = imperfections.dead_transmittance
        return f"{rows} rows and {columns} columns pass an amplitude of {passed:.3g}"


class MaskShift(Imperfection):
    """The mask is not centred."""

    name = "mask shift"
    absent = "mask centred"
    fields = ("shift_y", "shift_x")

    def reason(self, model: Model) -> str:
        """Say how far the mask is shifted."""
        imperfections = model.conditions.imperfections
        moved = math.hypot(imperfections.shift_y, imperfections.shift_x)
        return f"mask {moved * 1e6:.3g} um off the axis"


class MaskRotation(Imperfection):
    """The mask is turned, so its field no longer separates into rows and columns."""

    name = "mask rotation"
    free = False
    absent = "mask straight"
    fields = ("rotation",)

    def error(self, comparison: Comparison) -> float:
        """Relative L2 at the embedding if it is ignored."""
        return comparison.rotated()

    def reason(self, model: Model) -> str:
        """Say how far the mask's edge moves."""
        angle, camera = model.conditions.imperfections.rotation, model.camera
        half = (
            max(
                camera.window.rows * camera.panel.pitch_y,
                camera.window.columns * camera.panel.pitch_x,
            )
            / 2
        )
        moved = abs(angle) * half
        return f"turned by {1e3 * angle:.3g} mrad: its edge moves {moved * 1e6:.3g} um"


class DistanceError(Imperfection):
    """The sensor is not where it should be."""

    name = "distance error"
    absent = "sensor in place"
    fields = ("distance_error",)

    def reason(self, model: Model) -> str:
        """Say how far the distance is off."""
        error, distance = model.conditions.imperfections.distance_error, model.camera.distance
        return (
            f"sensor {error * 1e6:.3g} um too far, {100 * error / distance:.2g} % of its distance"
        )


def actual_camera(model: Model) -> Camera:
    """Return the camera with the distance it really has."""
    return model.conditions.imperfections.actual(model.camera)
