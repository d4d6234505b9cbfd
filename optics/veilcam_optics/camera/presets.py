"""Cameras to begin with, by name, each with the sources of its numbers.

What no source gives is ours and says so: which window of a modulator is used, and how far the
sensor is from it. All have the sensor of the Raspberry Pi HQ camera.
"""

from dataclasses import dataclass, replace

from veilcam_optics.camera.geometry import Camera, Panel, Window
from veilcam_optics.errors import require_choice


@dataclass(frozen=True, slots=True)
class Preset:
    """A camera, and where its numbers come from."""

    camera: Camera
    source: str


def _centred(panel: Panel, rows: int, columns: int) -> Window:
    return Window(rows, columns, (panel.rows - rows) // 2, (panel.columns - columns) // 2)


_LC_2012 = Panel(
    rows=768,
    columns=1024,
    pitch_y=36e-6,
    pitch_x=36e-6,
    aperture_y=36e-6,
    aperture_x=36e-6,
    levels=256,
    filter_cycle=(),
).with_fill_factor(0.58)

_DLP7000 = replace(
    _LC_2012, pitch_y=13.68e-6, pitch_x=13.68e-6, aperture_y=13e-6, aperture_x=13e-6, levels=2
).with_fill_factor(0.92)

PRESETS = {
    "paper": Preset(
        Camera(),
        "E. Bezzam, M. Vetterli and M. Simeoni, Privacy-Enhancing Optical Embeddings for Lensless "
        "Classification (2022): ST7735R display, Sony IMX477, 4 mm apart. Sub-pixels: data sheet "
        "of the display module.",
    ),
    "slm": Preset(
        Camera(panel=_LC_2012, window=_centred(_LC_2012, 64, 64), distance=10e-3),
        "HOLOEYE LC 2012, a transmissive liquid crystal: 1024 x 768 pixels of 36 um, fill factor "
        "58 %, 256 levels (data sheet, holoeye.com/lc-2012-spatial-light-modulator). Amplitude "
        "alone, between crossed polarisers. Window and distance are ours.",
    ),
    "dmd": Preset(
        Camera(panel=_DLP7000, window=_centred(_DLP7000, 64, 64), distance=30e-3).monochrome(
            633e-9
        ),
        "Texas Instruments DLP7000, micromirrors: 1024 x 768 of 13.68 um, fill factor 92 %, on or "
        "off (data sheet DLPS026). The light path is unfolded: the tilt of the mirrors, 12 "
        "degrees, is not computed. Wavelength (helium-neon), window and distance are ours.",
    ),
}
"""By name."""


def preset(name: str) -> Camera:
    """Return the camera of that name.

    Raises:
        OpticsError: a name that is not in :data:`PRESETS`.
    """
    require_choice("preset", name, tuple(PRESETS))
    return PRESETS[name].camera
