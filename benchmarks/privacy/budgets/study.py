"""Masks of one form and one size, and what attackers read behind them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
import torch
import typer
from torch import Tensor

from veilcam_optics.camera.geometry import Embedding
from veilcam_optics.decoding import SceneDecoding
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach
from veilcam_training.attacks.known_pairs import Mask, Reader, by_anchors, hits, readers, tuned
from veilcam_training.attacks.linkage import by_products, link_area
from veilcam_training.attacks.networks import (
    TRIALS,
    Build,
    Seen,
    best_of,
    by_network,
    convolutions,
    perceptron,
)
from veilcam_training.attacks.sets import VIEWS, SeenSets, by_sets
from veilcam_training.attacks.victim import FORMS, FreshMasks, Victim, VictimMask
from veilcam_training.bundle import Bundle
from veilcam_training.data import Images
from veilcam_training.seeding import stream

Form = Literal["white", "raw"]
FORM_NAMES: tuple[Form, ...] = ("white", "raw")
EMBEDDINGS = (Embedding(3, 4), Embedding(12, 16), Embedding(24, 32))
CLASSES = 10
BAR = 1.0
"""Points above chance that count as nothing."""
EPOCHS, SET_EPOCHS = 6, 12
RIDGES = (0.1, float("inf"))


@dataclass(frozen=True)
class Plan:
    """How much is tried.

    Attributes:
        counts: of captures that are known, in rising order; the first is 0.
        own: masks of the attacker's own to learn angles behind.
        check: masks to choose settings by.
        test: masks to be judged behind.
        asked: captures of each to be read.
        crowd: of captures of which nothing is known, in rising order.
        sets: masks to learn from, to choose by and to be judged behind, where nothing is known.
        wide: masks of the attacker's own to learn from without any that is known, and captures of
            each.
    """

    counts: tuple[int, ...] = (0, 1, 3, 10, 30, 100, 300)
    own: int = 30
    check: int = 6
    test: int = 20
    asked: int = 300
    wide: tuple[int, int] = (250, 30)
    crowd: tuple[int, ...] = (3, 10, 30, 100)
    sets: tuple[int, int, int] = (150, 30, 40)


class Digits:
    """Scenes of which every class comes equally often."""

    def __init__(self, images: Images) -> None:
        self._images = images
        self._places = [(images.labels == label).nonzero().flatten() for label in range(CLASSES)]

    def draw(self, count: int, random: torch.Generator) -> tuple[Tensor, Tensor]:
        """Scenes (count, rows, columns) and their classes."""
        labels = torch.randint(CLASSES, (count,), generator=random)
        chosen = [
            int(self._places[label][torch.randint(len(self._places[label]), (), generator=random)])
            for label in labels.tolist()
        ]
        return self._images.scenes(torch.tensor(chosen)), labels


def camera(bundle: Bundle, cell: tuple[Form, Embedding], generator: torch.Generator) -> Victim:
    """Of fresh masks, with light that has interference which decoders do not know of."""
    if bundle.fresh is None:
        raise typer.BadParameter("use a bundle of mode fresh")
    form, embedding = cell
    light = TransferOperator(bundle.camera, bundle.scene, embedding, reach=Reach(6, 1))
    assumed = TransferOperator(bundle.camera, bundle.scene, embedding)
    decoding = SceneDecoding(assumed, bundle.fresh.statistics.in_torch(), bundle.fresh.noise)
    return Victim(
        light,
        FreshMasks(bundle.camera, bundle.fresh.distribution),
        FORMS[form],
        # What leaves raw needs no whitening.
        decoding=decoding if form == "white" else None,
        generator=generator,
    )


@dataclass(frozen=True)
class Point:
    """The worst attacker at one count: its name, and what it read of each mask [%]."""

    attacker: str
    shares: list[float]

    @property
    def mean(self) -> float:
        """Over masks [%]."""
        return float(np.mean(self.shares))


class Study:
    """One form at one size: masks, and what is known of them.

    Args:
        bundle: of mode fresh.
        cell: the form in which captures leave, and how large they are.
        data: to learn from, and to be judged by.
        plan: how much is tried.
        seed: of all that is drawn.
    """

    def __init__(
        self,
        bundle: Bundle,
        cell: tuple[Form, Embedding],
        data: tuple[Digits, Digits],
        plan: Plan,
        seed: int,
    ) -> None:
        (form, embedding), self._plan = cell, plan
        self._shape, self._seed = embedding.shape, seed
        self._random = stream(seed, "scenes", form, embedding.size)
        self._victim = camera(bundle, cell, stream(seed, "masks", form, embedding.size))
        training, test = data
        self._known = training.draw(plan.counts[-1], self._random)
        self._own = self._masks(training, plan.own)
        self._check = self._masks(training, plan.check)
        self._test = self._masks(test, plan.test)
        self._training = training

    def _masks(self, digits: Digits, count: int) -> list[Mask]:
        found = []
        for _ in range(count):
            mask = self._victim.mask()
            asked = digits.draw(self._plan.asked, self._random)
            found.append(Mask(self._seen(mask, *self._known), self._seen(mask, *asked)))
        return found

    def _seen(self, mask: VictimMask, scenes: Tensor, labels: Tensor) -> Seen:
        return Seen(self._victim.capture(mask, scenes), labels)

    def keyless(self) -> dict[str, Reader]:
        """Networks fitted to captures behind other keys; they need none that is known."""
        masks, captures = self._plan.wide
        parts = []
        for _ in range(masks):
            drawn = self._training.draw(captures, self._random)
            parts.append(self._seen(self._victim.mask(), *drawn))
        learned, check = _joined(parts), _joined([mask.asked for mask in self._check])
        pictures: list[Build] = [partial(convolutions, self._shape, width=32), perceptron]
        tried: dict[str, tuple[Callable[[Tensor], Tensor], list[Build]]] = {
            "network behind other keys": (_scaled, pictures),
            # How bright it is differs by mask, and by scene.
            "perceptron behind other keys, with brightness": (_as_read, [perceptron]),
        }
        return {name: _fitted(*each, learned, check) for name, each in tried.items()}

    def attack(self, keyless: Mapping[str, Reader], count: int) -> Point:
        """The worst attacker that knows ``count`` captures."""
        own, check, test = (
            [mask.of_first(count) for mask in masks]
            for masks in (self._own, self._check, self._test)
        )
        tried = dict(keyless)
        if count > 0:
            tried |= readers()
            for ridge in RIDGES:
                name = f"angles, ridge {ridge:g}"
                tried[name] = by_anchors(own, check, CLASSES, ridge=ridge, epochs=EPOCHS)
        name, best = tuned(tried, check, CLASSES)
        shares = 100 * hits(best, test, CLASSES).double().mean(1)
        return Point(name, shares.tolist())

    def same_scene(self, scenes: int = 20) -> float:
        """Area under the curve of "two captures of one mask show the same scene"."""
        pairs = []
        for _ in range(self._plan.test):
            mask = self._victim.mask()
            shown, _ = self._training.draw(scenes, self._random)
            pairs.append([self._victim.capture(mask, shown) for _ in range(2)])
        first, second = (torch.stack([pair[side] for pair in pairs]) for side in range(2))
        return link_area(by_products, first, second)


def _joined(parts: Sequence[Seen]) -> Seen:
    vectors = torch.cat([each.vectors for each in parts])
    return Seen(vectors, torch.cat([each.labels for each in parts]))


def _fitted(
    change: Callable[[Tensor], Tensor], builds: Sequence[Build], learned: Seen, check: Seen
) -> Reader:
    tried = [partial(by_network, build=build, trial=TRIALS[0], epochs=EPOCHS) for build in builds]
    seen = [Seen(change(each.vectors), each.labels) for each in (learned, check)]
    scores = best_of(tried)(seen[0], seen[1], CLASSES)

    def read(known: Seen, vectors: Tensor, classes: int) -> Tensor:
        del known, classes
        with torch.no_grad():
            return scores(change(vectors)).double()

    return read


def crowd(
    bundle: Bundle,
    cell: tuple[Form, Embedding],
    data: tuple[Digits, Digits],
    plan: Plan,
    seed: int,
) -> dict[int, Point]:
    """The worst attacker that has captures of a mask of which nothing is known, by how many others.

    Arguments are those of :class:`Study`.
    """
    (form, embedding), most = cell, plan.crowd[-1] + 1
    random = stream(seed, "crowd", form, embedding.size)
    victim = camera(bundle, cell, stream(seed, "masks of crowds", form, embedding.size))

    def sets(digits: Digits, masks: int) -> SeenSets:
        drawn = [digits.draw(most, random) for _ in range(masks)]
        seen = victim.watch(torch.stack([scenes for scenes, _ in drawn]))
        return SeenSets(seen.released, torch.stack([labels for _, labels in drawn]))

    parts = [sets(each, plan.sets[i]) for i, each in enumerate((data[0], data[0], data[1]))]
    points = {}
    for others in plan.crowd:
        learned, check, test = (
            SeenSets(each.captures[:, : others + 1], each.labels[:, : others + 1]) for each in parts
        )
        best = -1.0
        for view in VIEWS:
            scores = by_sets(learned, check, CLASSES, view=view, trial=TRIALS[0], epochs=SET_EPOCHS)
            with torch.no_grad():
                right, asked = (
                    (scores(each.captures).argmax(2) == each.labels).double().mean(1)
                    for each in (check, test)
                )
            if float(right.mean()) > best:
                best = float(right.mean())
                points[others] = Point(f"sets {view.__name__}", (100 * asked).tolist())
    return points


def _scaled(vectors: Tensor) -> Tensor:
    """Less their own mean and of variance 1: brightness apart, which differs from mask to mask."""
    apart = vectors - vectors.mean(1, keepdim=True)
    return apart / apart.std(1, keepdim=True).clamp_min(torch.finfo(vectors.dtype).tiny)


def _as_read(vectors: Tensor) -> Tensor:
    return vectors
