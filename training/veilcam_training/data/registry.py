"""Every data set by name."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from veilcam_training.data import celeba, faces
from veilcam_training.data.base import Source
from veilcam_training.data.cifar10 import Cifar10Source
from veilcam_training.data.collection import is_collection
from veilcam_training.data.idx import CLOTHES, DIGITS, IdxSource
from veilcam_training.data.image_folder import NAME, ImageFolderSource
from veilcam_training.errors import require

SOURCES: Mapping[str, Callable[[Path], Source]] = {
    "mnist": partial(IdxSource, "mnist", DIGITS),
    "fashion": partial(IdxSource, "fashion", CLOTHES),
    "cifar10": Cifar10Source,
    **{name: partial(faces.FacesSource, name) for name in faces.ATTRIBUTES},
    **{name: partial(celeba.CelebaSource, name) for name in celeba.ATTRIBUTES},
    NAME: ImageFolderSource,
}


def open_source(name: str, folder: Path, *, skip_damaged: bool = False) -> Source:
    """Open data set ``name``, with its files in ``folder``; nothing is read yet.

    Args:
        name: name of the data set.
        folder: folder of its files.
        skip_damaged: own pictures that cannot be read are left out.

    Raises:
        TrainingError: an unknown name, a folder that is not there, or damaged files to leave out of
            a data set that is known as a whole.
    """
    require(name in SOURCES, f"data set {name!r} is unknown: use one of {', '.join(SOURCES)}")
    require(folder.is_dir(), f"{folder} is not a folder: give the one that holds {name} as --data")
    if skip_damaged:
        require(name == NAME, f"{name} is used whole: leave out --skip-damaged")
        return ImageFolderSource(folder, skip_damaged=True)
    return SOURCES[name](folder)


def recognise(folder: Path) -> str | None:
    """Name of the data set that ``folder`` shows by itself to hold: somebody's own pictures.

    Returns:
        None where it shows nothing; the data set has to be named then.
    """
    return NAME if is_collection(folder) else None
