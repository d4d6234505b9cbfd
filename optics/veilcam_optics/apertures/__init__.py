"""Masks other than the LCD's: coded apertures, phase masks, and measured point spread functions."""

from veilcam_optics.apertures.coded import lay_cells, mls_cells
from veilcam_optics.apertures.measured import (
    measured_psf,
    normalise_psf,
    read_image,
    remove_background,
)
from veilcam_optics.apertures.phase import diffuser_height, phase_plate

__all__ = [
    "diffuser_height",
    "lay_cells",
    "measured_psf",
    "mls_cells",
    "normalise_psf",
    "phase_plate",
    "read_image",
    "remove_background",
]
