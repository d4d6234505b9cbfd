"""Record of what a bundle's masks hide, from its three attackers."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from veilcam_optics.camera.masks import to_weights
from veilcam_training.bundle import Bundle, Hiding
from veilcam_training.data import Images
from veilcam_training.hiding.eye import drawn_eye
from veilcam_training.hiding.machine import recognised
from veilcam_training.hiding.pinholes import Measurer
from veilcam_training.hiding.reader import Reader, scenes_of
from veilcam_training.hiding.scenes import GROUP, drawn_scenes, random_masks

Values = npt.NDArray[Any]

_READ = 1000
"""Scenes that are read behind each mask."""


def measure(bundle: Bundle, training: Images, test: Images) -> Hiding:
    """Return what attackers without a key find behind a bundle's masks.

    Args:
        bundle: bundle with the masks in question.
        training: images that the reader learns.
        test: images that are recognised and read.
    """
    geometry = (bundle.camera, bundle.scene, bundle.embedding)
    own = [to_weights(levels, bundle.camera.panel) for levels in bundle.masks()]
    masks = [*own, *random_masks(bundle.camera)]
    eye = drawn_eye(*geometry, bundle.channels)
    seen = [eye.seen(mask) for mask in own]
    worst = int(np.argmax(seen))
    measurer = Measurer(*geometry, bundle.channels)
    picked = np.mean(
        [
            recognised(*geometry, scenes, [measurer(scenes, mask) for mask in masks])
            for scenes in _groups(bundle, test)
        ],
        axis=0,
    )
    read = _read(bundle, measurer, training, test, masks)
    count = len(own)
    return Hiding(
        digest=bundle.masks_digest,
        masks=count,
        scenes=len(eye.scenes),
        worst=worst,
        seen=seen[worst],
        random_seen=eye.random,
        pinhole_seen=eye.pinhole,
        recognised=float(picked[:count].max()),
        random_recognised=float(picked[count:].mean()),
        read=None if read is None else float(read[:count].max()),
        random_read=None if read is None else float(read[count:].mean()),
        read_chance=None if read is None else _chance(test),
    )


def _groups(bundle: Bundle, test: Images) -> list[Values]:
    """Candidates: a hundred of all classes and of the most frequent one, or drawn scenes."""
    if len(test) < GROUP:
        return [drawn_scenes(bundle.scene, bundle.channels, GROUP)]
    label = test.labels.bincount().argmax()
    of_one = torch.nonzero(test.labels == label).flatten()[:GROUP]
    groups = [scenes_of(test, slice(0, GROUP))]
    return groups if len(of_one) < GROUP else [*groups, scenes_of(test, of_one)]


def _read(
    bundle: Bundle, measurer: Measurer, training: Images, test: Images, masks: list[Values]
) -> Values | None:
    """Share of labels read behind each mask; None where all images show the same."""
    if int(test.labels.min()) == int(test.labels.max()):
        return None
    reader = Reader(bundle.camera, bundle.embedding, measurer, training, len(bundle.labels))
    scenes, labels = scenes_of(test, slice(0, _READ)), test.labels[:_READ]
    return np.array([reader.read(measurer(scenes, mask), labels) for mask in masks])


def _chance(test: Images) -> float:
    """Share of labels that the most frequent one is."""
    return float(test.labels.bincount().max() / len(test))
