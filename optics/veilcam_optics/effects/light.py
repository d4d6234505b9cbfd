"""Effects of the light on its way from the scene through the panel to the sensor."""

from __future__ import annotations

import math
from dataclasses import replace

from veilcam_optics.effects.base import Comparison
from veilcam_optics.effects.model import Model
from veilcam_optics.transfer.operator import Reach


class Probed:
    """An effect whose error is measured by leaving it out."""

    name = ""
    free = True

    def without(self, model: Model) -> Model:
        """See :class:`~veilcam_optics.effects.base.Effect`."""
        raise NotImplementedError

    def error(self, comparison: Comparison) -> float:
        """Relative L2 at the embedding if it is ignored."""
        return comparison.error(self.without(comparison.model))


class Diffraction(Probed):
    """Light spreads behind a sub-pixel, against its geometric shadow."""

    name = "diffraction"
    free = False

    def present(self, model: Model) -> bool:
        """Always."""
        return bool(model)

    def without(self, model: Model) -> Model:
        """Geometric shadows."""
        return replace(model, sampling=replace(model.sampling, diffraction=False))

    def reason(self, model: Model) -> str:
        """Fresnel number."""
        panel, distance = model.camera.panel, model.actual_camera.distance
        side = min(panel.aperture_y, panel.aperture_x)
        number = side**2 / (max(model.camera.wavelengths) * distance)
        spread = "edges blur a little" if number > 10 else "light spreads beyond the shadow"
        return f"Fresnel number {number:.3g}: {spread}"

    def absent(self) -> str:
        """Never used: it is always there."""
        return "no light"


class SphericalWavefront(Probed):
    """The wave from a scene at a finite distance is curved."""

    name = "spherical wavefront"

    def present(self, model: Model) -> bool:
        """Always."""
        return bool(model)

    def without(self, model: Model) -> Model:
        """A scene at infinity."""
        return replace(model, sampling=replace(model.sampling, spherical=False))

    def reason(self, model: Model) -> str:
        """Magnification of the shadow."""
        ratio = model.actual_camera.distance / model.scene.distance
        edge = ratio * model.camera.window.rows * model.camera.panel.pitch_y / 2
        return f"shadow magnified by {100 * ratio:.2g} %: its edge moves {edge * 1e6:.3g} um"

    def absent(self) -> str:
        """Never used: it is always there."""
        return "scene at infinity"


class DeadSpace(Probed):
    """Wiring between the sub-pixels lets no light through."""

    name = "dead space"

    def present(self, model: Model) -> bool:
        """Where apertures are smaller than their pitch."""
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

    def absent(self) -> str:
        """Apertures fill the panel."""
        return "apertures as wide as their pitch"


class Interference(Probed):
    """Light of different sub-pixels interferes."""

    name = "neighbour interference"
    free = False

    def present(self, model: Model) -> bool:
        """With more than one sub-pixel, and diffraction."""
        return model.sampling.diffraction and model.camera.mask_shape != (1, 1)

    def without(self, model: Model) -> Model:
        """Irradiances of sub-pixels add up."""
        return model.with_sampling(reach=Reach(0, 0))

    def error(self, comparison: Comparison) -> float:
        """Relative L2 at the embedding if it is ignored."""
        return comparison.interference()

    def reason(self, model: Model) -> str:
        """Fringes against pixels."""
        distance, panel = model.actual_camera.distance, model.camera.panel
        apart = panel.pitch_y * (len(set(panel.filter_cycle)) or 1)
        fringe = max(model.camera.wavelengths) * distance / apart
        pixel = model.camera.sensor.height / model.embedding.rows
        return f"fringes of {fringe * 1e6:.3g} um, averaged over pixels of {pixel * 1e6:.3g} um"

    def absent(self) -> str:
        """Nothing to interfere with."""
        return "one sub-pixel, or no diffraction"


class ColourFilters(Probed):
    """Every sub-pixel row passes one colour."""

    name = "colour filters"

    def present(self, model: Model) -> bool:
        """Where the panel has them."""
        return bool(model.camera.panel.filter_cycle)

    def without(self, model: Model) -> Model:
        """All rows pass all light."""
        panel = replace(model.camera.panel, filter_cycle=(), filter_amplitudes=())
        return replace(model, camera=replace(model.camera, panel=panel))

    def reason(self, model: Model) -> str:
        """Colours apart."""
        cycle = "".join("RGB"[channel] for channel in model.camera.panel.filter_cycle)
        return f"rows pass {cycle} in turn"

    def absent(self) -> str:
        """None on the panel."""
        return "panel without filters"


class FilterLeakage(Probed):
    """A filter passes some light of the other colours: leakage, or measured amplitudes."""

    name = "filter leakage"
    free = False

    def present(self, model: Model) -> bool:
        """Where the panel has filters that are not ideal."""
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

    def absent(self) -> str:
        """Ideal or none."""
        return "no filters, or ideal ones"


class Spectrum(Probed):
    """The light of a channel has a width."""

    name = "spectrum per channel"
    free = False

    def present(self, model: Model) -> bool:
        """Where a bandwidth is given."""
        return any(model.conditions.bandwidth)

    def without(self, model: Model) -> Model:
        """One wavelength per channel."""
        return replace(model, conditions=replace(model.conditions, bandwidth=(0.0, 0.0, 0.0)))

    def error(self, comparison: Comparison) -> float:
        """Relative L2 at the embedding if it is ignored."""
        return comparison.sampled("wavelengths", 1)

    def reason(self, model: Model) -> str:
        """Relative width."""
        widest = max(
            width / wavelength
            for width, wavelength in zip(
                model.conditions.bandwidth, model.camera.wavelengths, strict=True
            )
        )
        return f"bandwidth up to {100 * widest:.2g} % of the wavelength"

    def absent(self) -> str:
        """None given."""
        return "one wavelength per channel"


class Depth(Probed):
    """The scene is not flat."""

    name = "depth layers"
    free = False

    def present(self, model: Model) -> bool:
        """Where a range is given."""
        return model.conditions.depth_range > 0

    def without(self, model: Model) -> Model:
        """A flat scene."""
        return replace(model, conditions=replace(model.conditions, depth_range=0.0))

    def error(self, comparison: Comparison) -> float:
        """Relative L2 at the embedding if it is ignored."""
        return comparison.sampled("layers", 1)

    def reason(self, model: Model) -> str:
        """Relative depth."""
        share = model.conditions.depth_range / model.scene.distance
        return f"depth is {100 * share:.2g} % of the distance"

    def absent(self) -> str:
        """None given."""
        return "flat scene"


class OffAxis(Probed):
    """Oblique light is fainter, and spreads differently: the field has no single PSF."""

    name = "off-axis field"
    free = False

    def present(self, model: Model) -> bool:
        """Where an angle is given."""
        return model.conditions.off_axis > 0

    def without(self, model: Model) -> Model:
        """One point spread function, nothing fades."""
        return replace(model, conditions=replace(model.conditions, off_axis=0.0))

    def error(self, comparison: Comparison) -> float:
        """Relative L2 at the embedding if it is ignored."""
        return comparison.off_axis(None)

    def reason(self, model: Model) -> str:
        """Angle and fading."""
        angle = model.conditions.off_axis
        fade = 100 * (1 - math.cos(angle) ** 4)
        return f"up to {math.degrees(angle):.3g} degrees: {fade:.2g} % darker at the edge"

    def absent(self) -> str:
        """None given."""
        return "paraxial scene"


class StrayLight(Probed):
    """Some light is scattered evenly over the sensor."""

    name = "stray light"

    def present(self, model: Model) -> bool:
        """Where a share is given."""
        return model.conditions.stray_light > 0

    def without(self, model: Model) -> Model:
        """Nothing is scattered."""
        return replace(model, conditions=replace(model.conditions, stray_light=0.0))

    def reason(self, model: Model) -> str:
        """Its share."""
        return f"{100 * model.conditions.stray_light:.2g} % of the light is spread evenly"

    def absent(self) -> str:
        """None given."""
        return "no scattered light"


class Binning(Probed):
    """An embedding value is an average over its pixel."""

    name = "pixel binning"

    def present(self, model: Model) -> bool:
        """Always."""
        return bool(model)

    def without(self, model: Model) -> Model:
        """Read at the pixel's centre."""
        return replace(model, sampling=replace(model.sampling, binning=False))

    def reason(self, model: Model) -> str:
        """Pixels against structure."""
        sensor, embedding = model.camera.sensor, model.embedding
        pixel = max(sensor.height / embedding.rows, sensor.width / embedding.columns)
        image = model.scene.pixel_at_sensor(model.actual_camera)
        return (
            f"embedding pixels of {pixel * 1e6:.3g} um, scene pixels of {image * 1e6:.3g} um on it"
        )

    def absent(self) -> str:
        """Never used: it is always there."""
        return "points for pixels"
