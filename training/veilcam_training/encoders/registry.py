"""Every encoder by name."""

from collections.abc import Callable, Mapping

import torch

from veilcam_training.encoders.base import LinearEncoder, Setup
from veilcam_training.encoders.baselines import (
    APERTURE_DISTANCE,
    DIFFUSER_DISTANCE,
    LENS_DISTANCE,
    coded_aperture_psf,
    diffuser_psf,
    lens_psf,
)
from veilcam_training.encoders.digital import Digital
from veilcam_training.encoders.imperfections import PanelErrors
from veilcam_training.encoders.masks import NO_ERRORS, FixedMask, LearnedMask
from veilcam_training.encoders.psf import PsfEncoder, PsfFile, read_psf
from veilcam_training.errors import TrainingError, require

Maker = Callable[[Setup, torch.Generator, PanelErrors], LinearEncoder]

ENCODERS: Mapping[str, Maker | None] = {
    "lens": lambda setup, _generator, _errors: PsfEncoder(setup, lens_psf(setup.camera)),
    "coded_aperture": lambda setup, _generator, _errors: PsfEncoder(
        setup, coded_aperture_psf(setup.camera, setup.scene)
    ),
    "diffuser": lambda setup, generator, _errors: PsfEncoder(
        setup, diffuser_psf(setup.camera, setup.scene, generator)
    ),
    "fixed_measured": None,
    "fixed_simulated": FixedMask,
    "learned": LearnedMask,
    "digital": lambda setup, generator, _errors: Digital(setup, generator),
}
"""How each is made without a measured PSF; None: not at all."""
WITH_PSF = {
    "lens": LENS_DISTANCE,
    "coded_aperture": APERTURE_DISTANCE,
    "diffuser": DIFFUSER_DISTANCE,
    "fixed_measured": None,
}
"""Those that a measured PSF may stand for, and their distance where it says none [m]; None: that
of the camera."""
WITH_PANEL = ("fixed_simulated", "learned")
"""Encoders that show their mask on the panel."""


def make_encoder(
    name: str,
    setup: Setup,
    generator: torch.Generator,
    *,
    psf: PsfFile | None = None,
    errors: PanelErrors = NO_ERRORS,
    pinhole: bool = False,
) -> LinearEncoder:
    """Make the encoder ``name``.

    Args:
        name: one of ``ENCODERS``.
        setup: setup of the camera.
        generator: generator of all random draws.
        psf: measured, to take the place of a simulated one; ``fixed_measured`` needs it.
        errors: errors of the panel, in training; encoders without a panel have none.
        pinhole: True starts ``learned`` from a pinhole; no other has a start.

    Raises:
        TrainingError: an unknown name, or a PSF, errors or a start that are missing or not wanted.
    """
    require(name in ENCODERS, f"encoder {name!r} is unknown: use one of {', '.join(ENCODERS)}")
    require(psf is None or name in WITH_PSF, f"encoder {name!r} takes no PSF: leave out --psf")
    require(
        not errors.any or name in WITH_PANEL, f"encoder {name!r} has no panel: leave out its errors"
    )
    encoder = _made(name, setup, generator, psf, errors)
    if pinhole:
        if not isinstance(encoder, LearnedMask):
            raise TrainingError(f"encoder {name!r} learns no mask: leave out mask_start")
        encoder.start_from_pinhole()
    return encoder


def _made(
    name: str,
    setup: Setup,
    generator: torch.Generator,
    psf: PsfFile | None,
    errors: PanelErrors,
) -> LinearEncoder:
    if psf is not None:
        return PsfEncoder(setup, read_psf(psf, WITH_PSF[name] or setup.camera.distance))
    maker = ENCODERS[name]
    if maker is None:
        raise TrainingError(f"encoder {name!r} needs a measured PSF: give --psf FILE")
    return maker(setup, generator, errors)
