"""Encoders: the cameras that training compares, behind one interface."""

from veilcam_training.encoders.base import Encoder, FixedEncoder, LinearEncoder, Setup
from veilcam_training.encoders.digital import Digital
from veilcam_training.encoders.imperfections import PanelErrors
from veilcam_training.encoders.masks import FixedMask, LearnedMask, Mask
from veilcam_training.encoders.psf import Psf, PsfEncoder, PsfFile, read_psf
from veilcam_training.encoders.registry import ENCODERS, make_encoder

__all__ = [
    "ENCODERS",
    "Digital",
    "Encoder",
    "FixedEncoder",
    "FixedMask",
    "LearnedMask",
    "LinearEncoder",
    "Mask",
    "PanelErrors",
    "Psf",
    "PsfEncoder",
    "PsfFile",
    "Setup",
    "make_encoder",
    "read_psf",
]
