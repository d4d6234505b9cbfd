"""What drawn faces tell without a key: attributes, who it is, and whether a scene comes again.

``python -m benchmarks.privacy.people --data data/faces --figures benchmarks/results/privacy.json``

Every capture is behind a fresh mask of its own, unless said otherwise. Persons that are judged were
never learned from. Attributes are read by a linear network, a perceptron and a convolutional one;
persons and scenes are linked by cosines and by learned metrics, linear and deep, among 50. The best
on captures set apart is judged.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.keys.options import shown_progress
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.attacks.linkage import (
    Link,
    blocks_of,
    by_cosines,
    by_metric,
    first_ranks,
    link_area,
)
from veilcam_training.attacks.metrics import auc, true_accept_rate
from veilcam_training.attacks.networks import (
    TRIALS,
    Build,
    Seen,
    best_of,
    by_network,
    convolutions,
    judged,
    linear,
    perceptron,
)
from veilcam_training.attacks.sets import SeenSets, by_average
from veilcam_training.attacks.victim import FORMS, FreshMasks, Victim
from veilcam_training.data import Images, open_source
from veilcam_training.seeding import stream

FORM_NAMES = ("raw", "sealed")
ATTRIBUTES = {"gender": "faces-gender", "smile": "faces-smiling", "glasses": "faces-glasses"}
EMBEDDING = Embedding(12, 16)
GALLERY = 50

app = typer.Typer(pretty_exceptions_enable=False)


@dataclass(frozen=True)
class Plan:
    """How many masks are learned from, checked with and judged; captures of a still scene."""

    masks: tuple[int, int, int] = (3000, 500, 1000)
    blocks: tuple[int, int, int] = (30, 6, 12)
    still: int = 8
    epochs: int = 12


Parts = tuple[Images, Images, Images]
"""Of persons to learn from, to check with and to judge."""


def parts_of(training: Images, test: Images) -> Parts:
    """Hold a tenth of the training persons apart."""
    groups = _persons(training)
    apart = torch.isin(groups, torch.unique(groups)[::10])
    return (
        training.take((~apart).nonzero().flatten()),
        training.take(apart.nonzero().flatten()),
        test,
    )


def _persons(images: Images) -> Tensor:
    if images.groups is None:
        raise typer.BadParameter("these faces say not who they are")
    return images.groups


def captured(victim: Victim, images: Images, chosen: Tensor) -> Tensor:
    """What leaves of chosen images (count,), each behind a mask of its own: (count, numbers)."""
    scenes = images.scenes(chosen)
    return torch.cat([victim.capture(victim.mask(), scene[None]) for scene in scenes])


def attributes(
    victim: Victim, sources: dict[str, Parts], plan: Plan, random: torch.Generator, *, picture: bool
) -> dict[str, float]:
    """AUC of each attribute; ``still_``: of the average over masks of one still scene."""
    found: dict[str, float] = {}
    first = next(iter(sources.values()))
    chosen = [
        torch.randint(len(images), (count,), generator=random)
        for images, count in zip(first, plan.masks, strict=True)
    ]
    seen = [captured(victim, *each) for each in zip(first, chosen, strict=True)]
    builds: list[Build] = [linear, perceptron]
    if picture:
        builds.append(partial(convolutions, EMBEDDING.shape))
    attacker = best_of(
        [
            partial(by_network, build=build, trial=trial, epochs=plan.epochs)
            for build in builds
            for trial in TRIALS[:2]
        ]
    )
    few = [each[: len(each) // plan.still] for each in chosen]
    still = [
        captured(victim, images, each.repeat_interleave(plan.still)).reshape(
            len(each), plan.still, -1
        )
        for images, each in zip(first, few, strict=True)
    ]
    for name, parts in sources.items():
        labels = [images.labels[each] for images, each in zip(parts, chosen, strict=True)]
        scores = attacker(Seen(seen[0], labels[0]), Seen(seen[1], labels[1]), 2)
        found[name] = _area(judged(scores, seen[2]), labels[2])
        sets = [
            SeenSets(vectors, each[: len(vectors), None].expand(-1, plan.still))
            for vectors, each in zip(still, labels, strict=True)
        ]
        averaged = by_average(sets[0], sets[1], 2, attacker=attacker)
        found[f"still_{name}"] = _area(judged(averaged, sets[2].captures), sets[2].labels[:, 0])
    return found


def _area(scores: Tensor, labels: Tensor) -> float:
    return auc(scores[:, 1] - scores[:, 0], labels == 1)


def links(victim: Victim, parts: Parts, plan: Plan, random: torch.Generator) -> dict[str, float]:
    """Rank-1 among 50 and TAR at FAR 1e-2 of persons and of scenes, and the AUC of scenes."""
    found: dict[str, float] = {}
    for what in ("person", "scene"):
        blocks = []
        for images, count in zip(parts, plan.blocks, strict=True):
            chosen = torch.cat([_pairs(images, what, random) for _ in range(count)])
            blocks.append(blocks_of(captured(victim, images, chosen), GALLERY))
        learned, check, test = blocks
        mean = torch.cat(learned).flatten(0, 1).mean(0)
        tried: list[Link] = [partial(by_cosines, mean=mean)]
        tried += [
            by_metric(learned, check, build=build, trial=TRIALS[0], epochs=plan.epochs)
            for build in (linear, perceptron)
        ]
        best = max(tried, key=lambda link: link_area(link, *check))
        with torch.no_grad():
            scores = best(*test)
        same = torch.eye(GALLERY, dtype=torch.bool).expand_as(scores)
        found[f"{what}_rank1"] = 100 * float(first_ranks(scores).double().mean())
        found[f"{what}_tar"] = 100 * true_accept_rate(scores.flatten(), same.flatten())
        found[f"{what}_auc"] = link_area(best, *test)
    return found


def _pairs(images: Images, what: str, random: torch.Generator) -> Tensor:
    """Places of two images of each of 50 persons, or of the same image twice: (100,)."""
    groups = _persons(images)
    known = torch.unique(groups)
    pairs = []
    for person in known[torch.randperm(len(known), generator=random)[:GALLERY]]:
        own = (groups == person).nonzero().flatten()
        mixed = own[torch.randperm(len(own), generator=random)]
        pairs.append(mixed[:2] if what == "person" else mixed[:1].repeat(2))
    return torch.cat(pairs)


def measured(
    sources: dict[str, Parts], scene: Scene, form: str, plan: Plan, seed: int
) -> dict[str, float]:
    """All figures of one form: areas, and shares [%]."""
    camera = Camera()
    light = TransferOperator(camera, scene, EMBEDDING)
    victim = Victim(
        light,
        FreshMasks(camera, MaskDistribution.uniform(camera)),
        FORMS[form],
        generator=stream(seed, "masks", form),
    )
    random = stream(seed, "scenes", form)
    told = attributes(victim, sources, plan, random, picture=form != "sealed")
    return told | links(victim, next(iter(sources.values())), plan, random)


@app.command()
def measure(
    *,
    data: Annotated[Path, typer.Option(help="Folder that holds faces.npz.")],
    form: Annotated[
        list[str] | None, typer.Option(help=f"Of {', '.join(FORM_NAMES)}; all by default.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of masks, scenes and noise.")] = 1,
    figures: FiguresOption = None,
) -> None:
    """Attack faces behind fresh masks, in every form."""
    opened = {name: open_source(task, data) for name, task in ATTRIBUTES.items()}
    sources = {name: parts_of(each.training(), each.test()) for name, each in opened.items()}
    scene = next(iter(opened.values())).scene
    with shown_progress() as progress:
        for each in progress.track(form or FORM_NAMES):
            found = measured(sources, scene, each, Plan(), seed)
            for name, value in found.items():
                print(f"{each:7}{name:16}{value:8.3f}", flush=True)
            record(figures, {f"people_{each}_{name}": round(v, 4) for name, v in found.items()})


if __name__ == "__main__":
    torch.set_num_threads(1)
    app()
