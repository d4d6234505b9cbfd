"""Data sets, read from disk in their published formats."""

from veilcam_training.data.base import Images, Source, Split, remarks_of, split
from veilcam_training.data.registry import SOURCES, open_source, recognise

__all__ = [
    "SOURCES",
    "Images",
    "Source",
    "Split",
    "open_source",
    "recognise",
    "remarks_of",
    "split",
]
