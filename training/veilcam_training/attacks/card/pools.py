"""Captures for attackers, collected mask by mask: a mask and all that it opens is forgotten next.

Masks come in pairs that see the same scenes, so that whoever links captures has something to link.
A pool is collected in parts, each from a seed of its own: one that was broken off goes on.
"""

import io
from collections import deque
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Self

import torch
from torch import Tensor

from veilcam_optics.files import write_whole
from veilcam_training.attacks.card.subject import Subject
from veilcam_training.attacks.networks import Progress
from veilcam_training.attacks.victim import Victim, VictimMask
from veilcam_training.data import Images
from veilcam_training.seeding import stream

CAPTURES = 10
"""Of each mask."""
PART = 20
"""Masks of one part."""
LEAKED = 3
"""Past epochs on a leaked list, where none is stored."""


@dataclass(frozen=True)
class Pool:
    """Captures of many masks; masks 2 i and 2 i + 1 saw the same scenes.

    Attributes:
        chosen: int64 (masks, captures): which pictures were seen.
        labels: int64 (masks, captures).
        released: embeddings as they left, float32 (masks, captures, numbers).
        right: decoded with the key, (masks, captures, rows, columns).
        wrong: decoded with the key of another mask, likewise.
        listed: decoded with what a leaked list has that fits best, likewise.
        scores: scores of the bundle's classifier, (masks, captures, labels); of none, where there
            is no classifier of these masks.
        places: int64 (masks,): among stored masks; -1 for one that never comes again.
    """

    chosen: Tensor
    labels: Tensor
    released: Tensor
    right: Tensor
    wrong: Tensor
    listed: Tensor
    scores: Tensor
    places: Tensor

    @property
    def masks(self) -> int:
        """Number of captures."""
        return len(self.labels)

    def take(self, masks: Tensor) -> Self:
        """Return the captures of some masks."""
        return type(self)(*(getattr(self, each.name)[masks] for each in fields(self)))


def collect(
    subject: Subject,
    images: Images,
    *,
    masks: int,
    own: bool,
    seed: int,
    folder: Path | None,
    progress: Progress,
) -> Pool:
    """Watch a camera change its mask.

    Args:
        subject: subject of the attack.
        images: before it.
        masks: number of masks, a multiple of :data:`PART`.
        own: True: the camera is an attacker's own.
        seed: seed of masks, keys, noise and scenes.
        folder: folder for parts; those in it are not collected again. None keeps nothing.
        progress: is told how many masks of how many are done.
    """
    parts = []
    for number in range(masks // PART):
        path = None if folder is None else folder / f"{'own' if own else 'seen'}-{number:04d}.pt"
        if path is not None and path.exists():
            parts.append(Pool(*torch.load(path, weights_only=True)))
        else:
            made = _part(subject, images, own=own, random=stream(seed, "pool", own, number))
            if path is not None:
                _write(path, made)
            parts.append(made)
        progress(PART * (number + 1), masks)
    return Pool(*(torch.cat([getattr(p, each.name) for p in parts]) for each in fields(Pool)))


def _write(path: Path, pool: Pool) -> None:
    content = io.BytesIO()
    torch.save([getattr(pool, each.name) for each in fields(pool)], content)
    write_whole(path, content.getvalue(), private=True)


def _part(subject: Subject, images: Images, *, own: bool, random: torch.Generator) -> Pool:
    victim = subject.camera(own=own, generator=random)
    listed = () if own else victim.leak(LEAKED)
    stranger = subject.camera(own=True, generator=random).mask()
    recent = deque[VictimMask](maxlen=2)
    rows: list[tuple[Tensor, ...]] = []
    for number in range(PART):
        if number % 2 == 0:
            chosen = draw(images, CAPTURES, random)
        mask = victim.mask()
        scenes = images.scenes(chosen)
        others = (each for each in reversed(recent) if each.place != mask.place or mask.place < 0)
        other = next(others, stranger)
        seen = _watch(subject, victim, mask, scenes, other=other, listed=listed)
        rows.append((chosen, images.labels[chosen], *seen, torch.tensor(mask.place)))
        # Two that differ: whichever mask comes next, one of them is another.
        if not recent or mask.place < 0 or recent[-1].place != mask.place:
            recent.append(mask)
    return Pool(*(torch.stack(each) for each in zip(*rows, strict=True)))


def draw(images: Images, count: int, random: torch.Generator) -> Tensor:
    """Pictures of classes that all have the same chance, int64 (count,)."""
    classes = torch.unique(images.labels)
    labels = classes[torch.randint(len(classes), (count,), generator=random)]
    chosen = []
    for label in labels:
        members = (images.labels == label).nonzero().flatten()
        chosen.append(members[torch.randint(len(members), (), generator=random)])
    return torch.stack(chosen)


@torch.no_grad()
def _watch(
    subject: Subject,
    victim: Victim,
    mask: VictimMask,
    scenes: Tensor,
    *,
    other: VictimMask,
    listed: tuple[VictimMask, ...],
) -> tuple[Tensor, ...]:
    measured = victim.measure(mask, scenes)
    released = subject.release(mask, measured)
    right = decode(subject, mask, released)
    wrong = decode(subject, other, released)
    best = best_listed(subject, listed, released) if listed else torch.zeros_like(right)
    # A camera of the attacker's own has no classifier of the bundle's, unless all masks share it.
    scores = torch.zeros(len(scenes), 0)
    if subject.reading is not None and victim.source is subject.source:
        scores = subject.reading(mask, measured)
    return released, right, wrong, best, scores


def decode(subject: Subject, mask: VictimMask, released: Tensor) -> Tensor:
    """Decode embeddings with the mask and its key, (count, rows, columns)."""
    if mask.decoder is None:
        raise ValueError("a subject's camera has scene statistics")
    return mask.decoder(subject.opening(mask, released))


def best_listed(subject: Subject, listed: tuple[VictimMask, ...], released: Tensor) -> Tensor:
    """Decode captures of one mask with the mask of a list that explains them best.

    A mask explains captures if what it decodes is a picture, in [0, 1], and if that picture gives
    the measurement again.
    """
    found = []
    for mask in listed:
        opened = subject.opening(mask, released)
        decoded = decode(subject, mask, released)
        outside = (decoded - decoded.clamp(0, 1)).square().mean() / decoded.square().mean()
        again = decoded.flatten(1) @ mask.transfer
        missed = (again - opened).square().mean() / opened.square().mean()
        found.append((float(outside + missed), decoded))
    return min(found, key=lambda each: each[0])[1]
