"""Every encoder by name."""

from collections.abc import Callable, Mapping
from pathlib import Path

import torch

from veilcam_training.encoders.base import LinearEncoder, Setup
from veilcam_training.encoders.baselines import coded_aperture_psf, diffuser_psf, lens_psf
from veilcam_training.encoders.digital import Digital
from veilcam_training.encoders.imperfections import PanelErrors
from veilcam_training.encoders.masks import NO_ERRORS, FixedMask, LearnedMask
from veilcam_training.encoders.psf import PsfEncoder, read_psf
from veilcam_training.errors import TrainingError, require

Maker = Callable[[Setup, torch.Generator, Path | None, PanelErrors], LinearEncoder]

ENCODERS: Mapping[str, Maker] = {
    "lens": lambda setup, _generator, _psf, _errors: PsfEncoder(setup, lens_psf(setup.camera)),
    "coded_aperture": lambda setup, _generator, _psf, _errors: PsfEncoder(
        setup, coded_aperture_psf(setup.camera, setup.scene)
    ),
    "diffuser": lambda setup, generator, _psf, _errors: PsfEncoder(
        setup, diffuser_psf(setup.camera, setup.scene, generator)
    ),
    "fixed_measured": lambda setup, _generator, psf, _errors: _measured(setup, psf),
    "fixed_simulated": lambda setup, generator, _psf, errors: FixedMask(setup, generator, errors),
    "learned": lambda setup, generator, _psf, errors: LearnedMask(setup, generator, errors),
    "digital": lambda setup, generator, _psf, _errors: Digital(setup, generator),
}
WITH_PANEL = ("fixed_simulated", "learned")
"""Those that show their mask on the panel."""


def make_encoder(
    name: str,
    setup: Setup,
    generator: torch.Generator,
    *,
    psf: Path | None = None,
    errors: PanelErrors = NO_ERRORS,
    pinhole: bool = False,
) -> LinearEncoder:
    """Encoder ``name``.

    Args:
        name: one of ``ENCODERS``.
        setup: what it is made for.
        generator: of whatever it draws at random.
        psf: file of the PSF of ``fixed_measured``; the others have none.
        errors: of the panel, in training; those without a panel have none.
        pinhole: True starts ``learned`` from a pinhole; no other has a start.

    Raises:
        TrainingError: an unknown name, or a PSF, errors or a start that are missing or not wanted.
    """
    require(name in ENCODERS, f"encoder {name!r} is unknown: use one of {', '.join(ENCODERS)}")
    if psf is not None and name != "fixed_measured":
        raise TrainingError(f"encoder {name!r} takes no PSF: leave out --psf")
    require(
        not errors.any or name in WITH_PANEL, f"encoder {name!r} has no panel: leave out its errors"
    )
    encoder = ENCODERS[name](setup, generator, psf, errors)
    if pinhole:
        if not isinstance(encoder, LearnedMask):
            raise TrainingError(f"encoder {name!r} learns no mask: leave out mask_start")
        encoder.start_from_pinhole()
    return encoder


def _measured(setup: Setup, psf: Path | None) -> LinearEncoder:
    if psf is None:
        raise TrainingError("encoder 'fixed_measured' needs a measured PSF: give --psf FILE")
    return PsfEncoder(setup, read_psf(psf, setup.camera.distance))
