"""Scenes in front of a simulated camera, from files, folders and data sets.

Data sets are training's: whoever tries a classifier looks at what it was trained for, split as it
was for the fit. It is the one door to training beside the bundle.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from veilcam_server.devices.simulated.scenes import FileScene, SceneSource, StillScene
from veilcam_server.errors import StartError
from veilcam_server.settings import Settings

SUFFIXES = (".npy", ".png", ".jpg", ".jpeg")
"""Of the files in a folder that are taken for images."""
_PARTS = ("validation", "test")


def open_scenes(settings: Settings, shape: tuple[int, int]) -> list[SceneSource]:
    """Return every scene that the settings name, in their order; each can be seen.

    Args:
        settings: checked.
        shape: rows and columns of a scene.

    Raises:
        StartError: a folder without images, or a data set that cannot be read.
        SensorError: an image that is missing or bad; its name is in the message.
    """
    if not settings.scenes:
        return [FileScene(settings.scene_file, shape)]
    deck = [scene for name in settings.scenes for scene in _named(name, shape)]
    for scene in deck:
        if isinstance(scene, FileScene):
            scene.read()
    return deck


def _named(name: str, shape: tuple[int, int]) -> Iterator[SceneSource]:
    path = Path(name)
    if path.is_dir():
        yield from _folder(path, shape)
    elif ":" in name and not path.exists():
        yield from _data_set(name, shape)
    else:
        yield FileScene(path, shape)


def _folder(folder: Path, shape: tuple[int, int]) -> Iterator[SceneSource]:
    paths = sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and path.is_file()
    )
    if not paths:
        raise StartError(f"--scenes {folder}: no image in this folder: use .npy, PNG or JPEG files")
    for path in paths:
        yield FileScene(path, shape)


def _data_set(name: str, shape: tuple[int, int]) -> Iterator[SceneSource]:
    """Return the images of a part of a data set; labels stay on the disk."""
    # Imported late: of all daemons, only those that look at a data set need it.
    from veilcam_training.data import SOURCES, open_source, split  # noqa: PLC0415
    from veilcam_training.errors import TrainingError  # noqa: PLC0415

    known, _, rest = name.partition(":")
    folder, _, part = rest.rpartition(":")
    if not folder:
        folder, part = rest, "validation"
    if part not in _PARTS:
        raise StartError(f"--scenes {name}: no part {part!r}: use {' or '.join(_PARTS)}")
    if known in SOURCES and not Path(folder).is_dir():
        raise StartError(f"--scenes {name}: {folder} is not a folder: give the one with {known}")
    try:
        source = open_source(known, Path(folder))
        images = source.test() if part == "test" else split(source.training()).validation
    except TrainingError as error:
        raise StartError(f"--scenes {name}: {error}") from None
    pixels = images.pixels
    if pixels.ndim == 4:
        pixels = pixels.permute(0, 2, 3, 1)
    for picture in pixels.numpy():
        yield StillScene(picture, shape)
