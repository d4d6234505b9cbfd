"""Joint error of a setting: all that it leaves out of the light, together.

Errors of different origin are taken for uncorrelated where settings are compared. Of few pixels
they may all have one sign: then they add up. So the setting that is chosen is looked at once more,
every change to the light with its sign.
"""

from veilcam_optics.effects.model import Model
from veilcam_optics.plan.paraxial import Missing
from veilcam_optics.plan.probe import Probe, relative


def joint_error(probe: Probe, full: Model, chosen: Model, missing: Missing | None) -> float:
    """Relative L2 of the light that a setting computes to exact light.

    Not in it are what zones of the field, rotation, number format and the grid's cells do.

    Args:
        probe: offsets where light is looked at.
        full: model with everything, and the farthest reach that counts.
        chosen: the setting; its step counts where it has one.
        missing: error of Fresnel's approximation at the same offsets; None for none.
    """
    wavelengths = max(2, chosen.sampling.wavelengths)
    layers = max(2, chosen.sampling.layers)
    full = full.with_sampling(wavelengths=wavelengths, layers=layers)
    grid = chosen.sampling.method == "grid"
    computed = chosen.with_sampling(
        reach=full.sampling.reach if grid else None, wavelengths=wavelengths, layers=layers
    )
    channels = None if missing is None else missing.channels
    exact = probe.transfer(full, channels=channels)
    light = probe.transfer(computed, channels=channels)
    if computed.sampling.diffraction and not grid:
        light = light + probe.straightened(computed, channels=channels)
    if missing is not None:
        exact = exact + (missing.grid if grid else missing.factored)
    return min(1.0, relative(light, exact))
