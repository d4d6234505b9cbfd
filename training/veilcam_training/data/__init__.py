"""Data sets, read from disk in their published formats."""

from veilcam_training.data.catalogue import SOURCES, open_source
from veilcam_training.data.images import Images, Source, Split, split

__all__ = ["SOURCES", "Images", "Source", "Split", "open_source", "split"]
