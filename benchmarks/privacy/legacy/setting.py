"""The camera of the demonstration bundles, 24 x 32, and what is shown to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
import typer
from benchmarks.privacy.keys.options import fresh_bundle
from benchmarks.privacy.keys.scenes import Scenes, Stock, load_faces, load_scenes
from torch import Tensor, nn

from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import SceneDecoding, fit_statistics
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach
from veilcam_server.demo_data import BUNDLE, FRESH
from veilcam_training.attacks.leaked import doubting, read_behind
from veilcam_training.attacks.networks import judged
from veilcam_training.attacks.victim import (
    SNR_DB,
    FreshMasks,
    MaskSource,
    ReleaseRule,
    StoredMasks,
    Victim,
)
from veilcam_training.bundle import read_bundle
from veilcam_training.data import Images, open_source
from veilcam_training.data.base import find
from veilcam_training.models.network import build_classifier
from veilcam_training.seeding import stream

DOUBT = 10 ** (-SNR_DB / 20)
"""Relative error that is expected of a mask that was found: that of the measurements that it was
found from. No captures are attacked to choose it."""


class Setting:
    """Pictures and cameras that all rows share.

    Args:
        data: folder of MNIST's files.
        faces: folder that holds ``faces.npz``; None: without faces.
    """

    def __init__(self, data: Path, faces: Path | None) -> None:
        bundle = fresh_bundle(FRESH)
        fresh = bundle.fresh
        assert fresh is not None, "a bundle of mode fresh"
        self.camera, self.distribution = bundle.camera, fresh.distribution
        self.decoding = (
            fresh.frame(bundle.camera, bundle.scene, bundle.embedding).in_torch().decoding()
        )
        self.light = TransferOperator(
            bundle.camera, bundle.scene, bundle.embedding, reach=Reach(6, 1)
        )
        """Interferes further than the operator of ``decoding`` says."""
        source = open_source("mnist", data)
        self.training, self.test = source.training(), source.test()
        held = len(self.training) // 6
        self.learned = self.training.take(torch.arange(held, len(self.training)))
        self.check = self.training.take(torch.arange(held))
        """What settings are chosen by, of those who learn from ``learned`` alone."""
        self.scenes: Scenes = load_scenes(bundle.scene.shape, data, faces)
        self.faces: Stock | None = None if faces is None else load_faces(faces, bundle.scene.shape)
        self._persons = None if faces is None else _persons(faces)
        self._classifier: nn.Module = build_classifier(fresh.layers, fresh.weights)

    def learned_masks(self) -> tuple[Tensor, ...]:
        """Of the pairs that come along."""
        pairs = read_bundle(BUNDLE).pairs
        return tuple(torch.from_numpy(to_weights(pair.levels, self.camera.panel)) for pair in pairs)

    def victim(
        self,
        release: ReleaseRule,
        seed: int,
        *,
        stored: Tensor | None = None,
        decoding: SceneDecoding | None = None,
        purpose: str = "victim",
    ) -> Victim:
        """A camera with fresh masks, or with one that is stored.

        Args:
            release: how embeddings leave.
            seed: of masks, keys and noise.
            stored: its one mask; None: fresh masks.
            decoding: what it knows of scenes; digits by default.
            purpose: cameras of another one have other masks.
        """
        source: MaskSource = FreshMasks(self.camera, self.distribution)
        return Victim(
            self.light,
            source if stored is None else StoredMasks([stored]),
            release,
            decoding=decoding or self.decoding,
            generator=stream(seed, purpose),
        )

    def face_decoding(self) -> SceneDecoding:
        """What a camera that is to read faces knows of scenes: of persons who are not judged.

        Raises:
            typer.BadParameter: there are no faces.
        """
        if self.faces is None:
            raise typer.BadParameter("there are no faces: give --faces")
        pixels = torch.from_numpy(self.faces.pixels)[self.faces_of(judged=False)].float() / 255
        statistics = fit_statistics([pixels], self.decoding.statistics.rank)
        return SceneDecoding(self.decoding.operator, statistics, self.decoding.noise)

    def faces_of(self, *, judged: bool) -> Tensor:
        """Places of the faces of the last third of the persons, who are judged, or of all others.

        Raises:
            typer.BadParameter: there are no faces.
        """
        if self._persons is None:
            raise typer.BadParameter("there are no faces: give --faces")
        known = torch.unique(self._persons)
        last = known[2 * len(known) // 3 :]
        return (torch.isin(self._persons, last) == judged).nonzero().flatten()

    def digits(self, part: Images, count: int, *purpose: str | int) -> tuple[Tensor, Tensor]:
        """Scenes (count, rows, columns), all different, and which digit they show."""
        order = torch.randperm(len(part), generator=stream(0, "digits", *purpose))[:count]
        return part.scenes(order), part.labels[order]

    def accuracy(self, weights: Tensor, measurements: Tensor, labels: Tensor) -> float:
        """Digits read [%] by whoever takes ``weights`` for the mask, with a network for all masks.

        Args:
            weights: found or known.
            measurements: (count, E).
            labels: (count,).
        """
        decoding = doubting(self.decoding, DOUBT)
        read = read_behind(decoding, weights, measurements)
        return percent(judged(self._classifier, read).argmax(1) == labels)


def _persons(folder: Path) -> Tensor:
    """Of each face, who it is."""
    path = find(folder / "faces.npz", advice="give the folder that holds it as --faces")
    with np.load(path, allow_pickle=False) as content:
        if "identity" not in content:
            raise typer.BadParameter(f"{path} does not say whose faces they are")
        return torch.from_numpy(content["identity"].astype(np.int64))


def percent(hits: Tensor) -> float:
    """Share of hits."""
    return 100 * float(hits.double().mean())
