"""Scenes in front of a simulated camera, from files, folders and data sets.

Data sets are training's: whoever tries a classifier looks at what it was trained for, split as it
was for the fit. It is the one door to training beside the bundle.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import structlog

from veilcam_optics.pictures import KINDS, SUFFIXES, choose_pictures, in_words
from veilcam_server.devices.errors import LightError
from veilcam_server.devices.simulated.scenes import FileScene, SceneSource, StillScene
from veilcam_server.errors import StartError
from veilcam_server.settings import Settings

_PARTS = ("validation", "test")

log = structlog.get_logger()


def open_scenes(settings: Settings, shape: tuple[int, ...]) -> list[SceneSource]:
    """Return every scene that the settings name, in their order; each can be seen.

    Args:
        settings: checked.
        shape: shape of a scene, (rows, columns) or (3, rows, columns).

    Raises:
        StartError: a folder without images, or a data set that cannot be read.
        LightError: images that are missing or bad; all of them are named.
    """
    if not settings.scenes:
        return [FileScene(settings.scene_file, shape)]
    skip = settings.skip_damaged
    deck = [scene for name in settings.scenes for scene in _named(name, shape, skip=skip)]
    seen: list[SceneSource] = []
    bad: list[LightError] = []
    for scene in deck:
        try:
            if isinstance(scene, FileScene) and (warning := scene.look()[1]) is not None:
                log.warning("picture of a small range", detail=f"scene file {scene.path} {warning}")
        except LightError as error:
            bad.append(error)
        else:
            seen.append(scene)
    if len(bad) == 1 and not (skip and seen):
        raise bad[0]
    if bad and not (skip and seen):
        told = "; ".join(map(str, bad))
        raise LightError(f"{len(bad)} of {len(deck)} scenes cannot be seen: {told}")
    for each in bad:
        log.warning("damaged picture passed over", detail=str(each))
    return seen


def _named(name: str, shape: tuple[int, ...], *, skip: bool) -> Iterator[SceneSource]:
    path = Path(name)
    if path.is_dir():
        yield from _folder(path, shape)
    elif ":" in name and not path.exists():
        yield from _data_set(name, shape, skip=skip)
    else:
        yield FileScene(path, shape)


def _folder(folder: Path, shape: tuple[int, ...]) -> Iterator[SceneSource]:
    paths, others = choose_pictures(sorted(folder.iterdir()), (".npy", *SUFFIXES))
    passed = f"passed over: {in_words(others)}" if others else "it is empty"
    if not paths:
        raise StartError(
            f"--scenes {folder}: no image in this folder ({passed}): use .npy, {KINDS} files"
        )
    if others:
        log.warning("files passed over", detail=f"--scenes {folder} {passed}")
    for path in paths:
        yield FileScene(path, shape)


def _data_set(name: str, shape: tuple[int, ...], *, skip: bool) -> Iterator[SceneSource]:
    """Yield the images of a part of a data set; labels stay on the disk."""
    # Imported late: of all daemons, only those that look at a data set need it.
    import torch  # noqa: PLC0415

    from veilcam_training.data import SOURCES, open_source, remarks_of, split  # noqa: PLC0415
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
        source = (
            open_source(known, Path(folder), skip_damaged=True)
            if skip
            else open_source(known, Path(folder))
        )
        images = source.test() if part == "test" else split(source.training()).validation
    except TrainingError as error:
        raise StartError(f"--scenes {name}: {error}") from None
    for remark in remarks_of(source):
        log.warning("remark on a data set", detail=f"--scenes {name}: {remark}")
    pixels = images.pixels
    if pixels.ndim == 4:
        pixels = pixels.permute(0, 2, 3, 1)
    deep = pixels.dtype != torch.uint8
    for picture in pixels.numpy().astype(np.uint16 if deep else np.uint8, copy=False):
        yield StillScene(picture, shape)
