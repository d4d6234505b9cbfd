"""Study: subject, pictures and captures that all rows of a card share, collected once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import torch
from torch import Tensor

from veilcam_training.attacks.card.pools import CAPTURES, Pool, collect, draw
from veilcam_training.attacks.card.subject import Subject
from veilcam_training.attacks.known_pairs import Mask
from veilcam_training.attacks.networks import (
    TRIALS,
    Attacker,
    Build,
    Correlations,
    Scores,
    Seen,
    Trial,
    by_length,
    by_length_density,
    by_means,
    by_neighbours,
    by_network,
    convolutions,
    judged,
    linear,
    perceptron,
)
from veilcam_training.attacks.sets import VIEWS, SeenSets, by_sets
from veilcam_training.data import Images
from veilcam_training.errors import require
from veilcam_training.seeding import stream

HELD = 0.2
"""Share of what is learned from that the worst attacker is chosen by."""
ATTACKERS = 0.6
"""Share of the pictures that attackers know; the camera sees the others."""

ASKED = 500
"""Captures that are to be read, behind each mask of many."""
SET = 100
"""Captures of one mask that are read together, by whoever knows nothing of them."""
SET_EPOCHS = 12
"""Most that a network on such sets is fitted for."""
LEAST = 100
"""Pictures of either part."""

Tell = Callable[[str, int, int], None]
"""Takes what is done, and how much of how much of it is."""


@dataclass(frozen=True)
class Plan:
    """Plan of the attacks: number of captures, and effort."""

    own: int
    """Masks of attackers' own cameras, to learn from."""
    seen: int
    """Masks of the camera itself, to be judged by."""
    long: int
    """Masks behind which many captures are taken: a third to tune by, the others to be judged."""
    own_long: int
    """Attackers' own masks of as many captures, to learn what these tell."""
    known: int
    """Labelled captures of each of those."""
    epochs: int
    """Most that a network is fitted for."""
    trials: tuple[Trial, ...]
    recovered: int
    """Masks that are looked for by gradient, of those behind which many captures are taken."""
    quick: bool = False
    """Whether thresholds are those of few captures."""


QUICK = Plan(
    own=100,
    seen=240,
    long=9,
    own_long=30,
    known=400,
    epochs=25,
    trials=TRIALS[1:2],
    recovered=0,
    quick=True,
)
"""2,400 captures: a gain of 0 is proven to be below three points."""
FULL = Plan(
    own=800, seen=2400, long=60, own_long=150, known=1000, epochs=15, trials=TRIALS, recovered=6
)
"""24,000 captures: a gain of 0 is proven to be below one point."""


def parted(images: Images, seed: int) -> tuple[Images, Images]:
    """Pictures that attackers know, and those that the camera sees.

    Raises:
        TrainingError: too few, or of one class alone.
    """
    known = round(ATTACKERS * len(images))
    require(
        min(known, len(images) - known) >= LEAST and len(torch.unique(images.labels)) > 1,
        f"{len(images)} pictures are too few: give {2 * LEAST} or more, of two classes or more",
    )
    order = torch.randperm(len(images), generator=stream(seed, "pictures"))
    return images.take(order[:known]), images.take(order[known:])


@dataclass(frozen=True)
class Shots:
    """Many captures behind one mask, and the pictures of those that are known."""

    captures: Mask
    scenes: Tensor
    """(known, rows, columns)."""


@dataclass(frozen=True)
class Contest:
    """Several attackers on one question: who was best where it does not count, and all of them."""

    name: str
    answer: Scores
    """Of the chosen one."""
    scores: Tensor
    """That it gave, (count, classes)."""
    shares: dict[str, float]
    """Of the judged captures that each had right."""


class Study:
    """Pools and pictures of one card.

    Args:
        subject: subject of the attack.
        images: gray, of the shape of the subject's scenes.
        plan: plan of the attacks.
        seed: seed of everything.
        folder: folder for pools; None keeps nothing.
        tell: is told of progress.
    """

    def __init__(
        self,
        subject: Subject,
        images: Images,
        plan: Plan,
        *,
        seed: int,
        folder: Path | None,
        tell: Tell,
    ) -> None:
        self.subject, self.plan, self.seed = subject, plan, seed
        self.theirs, self.ours = parted(images, seed)
        self._folder, self.tell = folder, tell

    @property
    def classes(self) -> int:
        """Number of answers."""
        return len(self.subject.bundle.labels)

    @cached_property
    def own(self) -> Pool:
        """Captures of attackers' own cameras."""
        return self._pool(self.theirs, self.plan.own, own=True)

    @cached_property
    def seen(self) -> Pool:
        """Captures of the camera itself."""
        return self._pool(self.ours, self.plan.seen, own=False)

    def _pool(self, images: Images, masks: int, *, own: bool) -> Pool:
        name = "masks of attackers' own" if own else "masks of the camera"
        tell = partial(self.tell, name)
        where = self._folder
        return collect(
            self.subject, images, masks=masks, own=own, seed=self.seed, folder=where, progress=tell
        )

    @cached_property
    def long(self) -> list[Shots]:
        """Many captures behind each of a few masks; the pictures that are known are the same."""
        return self._many(self.ours, self.plan.long, own=False)

    @cached_property
    def own_long(self) -> list[Mask]:
        """The same known pictures, and attackers' own, behind masks of attackers' own."""
        return [each.captures for each in self._many(self.theirs, self.plan.own_long, own=True)]

    def _many(self, images: Images, masks: int, *, own: bool) -> list[Shots]:
        random, found = stream(self.seed, "long", own), []
        chosen = draw(self.ours, self.plan.known, stream(self.seed, "known"))
        scenes, labels = self.ours.scenes(chosen), self.ours.labels[chosen]
        camera = self.subject.camera(own=own, generator=random)
        what = "attackers' masks of many captures" if own else "masks of many captures"
        for number in range(masks):
            asked, mask = draw(images, ASKED, random), camera.mask()
            captures = Mask(
                Seen(camera.capture(mask, scenes), labels),
                Seen(camera.capture(mask, images.scenes(asked)), images.labels[asked]),
            )
            found.append(Shots(captures, scenes))
            self.tell(what, number + 1, masks)
        return found

    @cached_property
    def in_sets(self) -> dict[str, Tensor]:
        """Return the captures of :attr:`long` that are read when a common mask is known.

        Of each view, bool (masks, captures).
        """
        held = max(1, round(HELD * len(self.own_long)))
        learned, check = _sets(self.own_long[held:]), _sets(self.own_long[:held])
        asked, found = _sets([each.captures for each in self.long]), dict[str, Tensor]()
        for number, view in enumerate(VIEWS):
            scores = by_sets(
                learned,
                check,
                self.classes,
                view=view,
                trial=self.plan.trials[0],
                epochs=SET_EPOCHS,
            )
            with torch.no_grad():
                right = scores(asked.captures).argmax(2) == asked.labels
            found[f"network on sets, {view.__name__}"] = right.reshape(self.plan.long, -1)
            self.tell("sets of captures of a mask", number + 1, len(VIEWS))
        return found

    @cached_property
    def blind(self) -> Contest:
        """Return the captures that are read by attackers who learned from cameras of their own."""
        return self.contest(
            self.of_release(),
            (self.own.released, self.own.labels),
            self.seen.released.flatten(0, 1),
            self.seen.labels.flatten(),
        )

    def contest(
        self,
        attackers: dict[str, Attacker],
        learned: tuple[Tensor, Tensor],
        asked: Tensor,
        truth: Tensor,
    ) -> Contest:
        """Let all learn; whoever is best on captures set apart is the one that counts.

        Args:
            attackers: attackers by name.
            learned: vectors (masks, captures, numbers) and labels (masks, captures), of which the
                last masks are set apart.
            asked: vectors (count, numbers).
            truth: true classes, int64 (count,).
        """
        vectors, labels = learned
        held = max(2, round(HELD * len(vectors)) // 2 * 2)
        kept, check = (
            Seen(vectors[part].flatten(0, 1), labels[part].flatten())
            for part in (slice(None, -held), slice(-held, None))
        )
        shares, tried = dict[str, float](), []
        for name, attacker in attackers.items():
            found = attacker(kept, check, self.classes)
            right = float((judged(found, check.vectors).argmax(1) == check.labels).double().mean())
            scores = judged(found, asked)
            shares[name] = float((scores.argmax(1) == truth).double().mean())
            tried.append((right, name, found, scores))
        _, chosen, answer, given = max(tried, key=lambda each: each[0])
        return Contest(chosen, answer, given, shares)

    def of_release(self) -> dict[str, Attacker]:
        """Attackers of what leaves."""
        embedding = self.subject.bundle.embedding
        shape = None if self.subject.form == "sealed" else embedding.shape
        return {
            "length": partial(by_length, bins=32),
            "density of lengths": partial(by_length_density, width=0.3),
            **_products(),
            **self._networks(shape),
        }

    def of_pictures(self) -> dict[str, Attacker]:
        """Attackers of what was decoded."""
        return {"class means": by_means, **self._networks(self.subject.bundle.scene.shape)}

    def _networks(self, shape: tuple[int, int] | None) -> dict[str, Attacker]:
        many = len(self.plan.trials) > 1
        builds: dict[str, Build] = {"linear": linear, "perceptron": perceptron}
        if shape is not None:
            builds["convolutions"] = partial(convolutions, shape)
            if many:  # a full card has the time
                builds["correlations"] = partial(Correlations, shape)
        return {
            f"{name}, start {trial.seed}" if many else name: partial(
                by_network, build=build, trial=trial, epochs=self.plan.epochs
            )
            for name, build in builds.items()
            for trial in self.plan.trials
        }

    @cached_property
    def read(self) -> Contest:
        """Captures decoded with the key, read by attackers of their own making."""
        return self.contest(
            self.of_pictures(),
            (self.own.right.flatten(2), self.own.labels),
            self.seen.right.flatten(2).flatten(0, 1),
            self.seen.labels.flatten(),
        )


def _sets(masks: Sequence[Mask]) -> SeenSets:
    asked = [mask.asked for mask in masks]
    captures = torch.cat([each.vectors.reshape(-1, SET, each.vectors.shape[1]) for each in asked])
    return SeenSets(captures, torch.cat([each.labels.reshape(-1, SET) for each in asked]))


def _products() -> dict[str, Attacker]:
    neighbours: Sequence[tuple[str, bool, int]] = (
        ("inner products", False, 10),
        ("distances", True, 10),
    )
    return {
        "class means": by_means,
        **{
            f"nearest by {name}": partial(by_neighbours, count=count, distances=distances)
            for name, distances, count in neighbours
        },
    }


def by_pairs(values: Tensor) -> Tensor:
    """Reshape captures (masks x captures,): two masks that saw the same scenes share a row."""
    return values.reshape(-1, 2 * CAPTURES)
