"""Encoders: the cameras that training compares, behind one interface."""

from veilcam_training.encoders.catalogue import ENCODERS, make_encoder
from veilcam_training.encoders.digital import Digital
from veilcam_training.encoders.encoder import Encoder, FixedEncoder
from veilcam_training.encoders.masks import FixedMask, LearnedMask, Mask
from veilcam_training.encoders.panel import PanelErrors
from veilcam_training.encoders.setup import Setup
from veilcam_training.encoders.spread import Spread, SpreadEncoder, read_spread

__all__ = [
    "ENCODERS",
    "Digital",
    "Encoder",
    "FixedEncoder",
    "FixedMask",
    "LearnedMask",
    "Mask",
    "PanelErrors",
    "Setup",
    "Spread",
    "SpreadEncoder",
    "make_encoder",
    "read_spread",
]
