"""Masks other than the LCD's: coded apertures, phase masks, and measured point spread functions."""

from veilcam_optics.apertures.coded import (
    fresnel_zones,
    lay_cells,
    mls_cells,
    mura_cells,
    mura_decoder,
    pinhole,
)
from veilcam_optics.apertures.measured import (
    measured_psf,
    normalise_psf,
    read_image,
    remove_background,
)
from veilcam_optics.apertures.phase import (
    contour_pattern,
    diffuser_height,
    lens,
    phase_for_pattern,
    phase_plate,
)

__all__ = [
    "contour_pattern",
    "diffuser_height",
    "fresnel_zones",
    "lay_cells",
    "lens",
    "measured_psf",
    "mls_cells",
    "mura_cells",
    "mura_decoder",
    "normalise_psf",
    "phase_for_pattern",
    "phase_plate",
    "pinhole",
    "read_image",
    "remove_background",
]
