"""The mask-independent frame: an embedding becomes the scene's best linear estimate.

Every mask mixes the scene in its own way. With the mask known, and the public mean and covariance
of scenes, the linear minimum-mean-square-error estimate takes the mask out again, so that one
classifier serves all masks.
"""

from veilcam_optics.decoding.decoder import (
    Decoder,
    Precision,
    SceneDecoding,
    prepare_decoder,
    unknown_share,
)
from veilcam_optics.decoding.frame import SceneFrame, read_frame, write_frame
from veilcam_optics.decoding.noise import DEFAULT_NOISE, MeasurementNoise
from veilcam_optics.decoding.statistics import SceneStatistics, fit_statistics

__all__ = [
    "DEFAULT_NOISE",
    "Decoder",
    "MeasurementNoise",
    "Precision",
    "SceneDecoding",
    "SceneFrame",
    "SceneStatistics",
    "fit_statistics",
    "prepare_decoder",
    "read_frame",
    "unknown_share",
    "write_frame",
]
