"""Table 6: pictures by a generator that was fitted to plaintext pairs, 24 x 32."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.keys.options import shown_progress
from benchmarks.privacy.paper.cells import (
    EXAMPLES,
    Cells,
    DataOption,
    PicturesOption,
    SourceOption,
    Values,
    WorkOption,
    difference,
    gray,
    likeness,
    mean,
    mean_picture,
    one_of_each,
    proven,
    published,
    row,
)
from benchmarks.privacy.paper.generator_attack import (
    LIGHT,
    PAPER,
    GeneratorTrial,
    PlaintextPairs,
    best_generator,
    paper_trial,
)
from benchmarks.privacy.paper.masks import KINDS, Kind, embedded, stored_mask
from benchmarks.privacy.paper.pictures import draw, kept
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.attacks.metrics import psnr
from veilcam_training.data import Images, Source, open_source
from veilcam_training.seeding import stream

PAIRS = (100, 1000, 10_000)
LEAST_HELD = 30
"""Pairs to choose by, at least; a tenth of those that are learned from."""
DesignName = Literal["light", "paper"]
DESIGNS = {"light": LIGHT, "paper": PAPER}


def trials(pairs: int, design: DesignName) -> list[GeneratorTrial]:
    """What an attacker tries: several seeds and rates where they are cheap."""
    if design == "paper":
        return [paper_trial(pairs, 50)]
    if pairs <= 100:
        return [GeneratorTrial(seed, rate=3e-3, batch=16, epochs=60) for seed in (1, 2, 3)]
    if pairs <= 1000:
        return [GeneratorTrial(seed, rate=rate, epochs=30) for seed, rate in ((1, 3e-3), (2, 1e-3))]
    return [GeneratorTrial(rate=3e-3, batch=64, epochs=12)]


def command(
    *,
    data: DataOption,
    source: SourceOption = "faces-gender",
    work: WorkOption = Path("runs/paper-generator"),
    count: Annotated[int, typer.Option(min=2, help="Pictures that are attacked.")] = 500,
    pairs: Annotated[
        list[int] | None, typer.Option(min=20, help="That the attacker holds; all by default.")
    ] = None,
    kind: Annotated[
        list[str] | None, typer.Option(help="Masks: 1, 10, 100 or 10random; all by default.")
    ] = None,
    design: Annotated[DesignName, typer.Option(help="Of the network.")] = "light",
    figures: FiguresOption = None,
    pictures: PicturesOption = None,
) -> None:
    """Fit generators to pairs behind few or many masks; other pairs tell when to stop."""
    opened, numbers = open_source(source, data), pairs or list(PAIRS)
    kinds = [each for each in KINDS if not kind or each.name in kind]
    test = opened.test()
    truth = gray(test, one_of_each(test, count, "generator", "test"))
    cells = Cells(work, {"source": source, "count": count, "design": design})
    attacked = Attacked(opened, masks_folder(work, source))
    found: dict[str, Values] = {}
    with shown_progress() as progress:
        task = progress.add_task("cells", total=len(kinds) * len(numbers))
        for each in kinds:
            for number in numbers:
                name = f"{each.name}_{number}"
                progress.update(task, description=name)
                cell = partial(attack, attacked, each, number, truth, design)
                found[name] = cells.get(name, cell)
                progress.advance(task)
    guess = psnr(mean_picture(opened).expand_as(truth), truth).tolist()
    tell(found, kinds, numbers, guess)
    record(figures, as_figures(found, guess))
    if pictures is not None:
        columns = [truth[:EXAMPLES], *(kept(cell["pictures"]) for cell in found.values())]
        draw(pictures / "generator.png", ["scene", *(n.replace("_", ": ") for n in found)], columns)


def masks_folder(work: Path, source: str) -> Path:
    """Where masks are kept that were learned for ``source``: beside the cells of all commands."""
    folder = work.absolute().parent / f"paper-masks-{source}"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder


class Attacked:
    """A camera with stored masks, and the pictures that an attacker has pairs of.

    Args:
        source: of the pictures.
        folder: of masks that were learned before.
    """

    def __init__(self, source: Source, folder: Path) -> None:
        self.folder, self.scene, self.images = folder, source.scene, source.training()
        self.operator = TransferOperator(Camera(), self.scene, Embedding())

    def masks(self, kind: Kind) -> list[Tensor]:
        """Of a kind."""
        camera = self.operator.camera
        return [
            stored_mask(
                self.folder, kind, place, camera=camera, scene=self.scene, images=self.images
            )
            for place in range(kind.masks)
        ]

    def pairs(self, kind: Kind, number: int) -> tuple[Tensor, Images, Tensor]:
        """Embeddings, images and scenes: ``number`` to learn from, and a tenth to choose by.

        Pictures to choose by are of other groups (people) than pictures to learn from, as those
        that are attacked are.
        """
        chosen, held = apart(self.images, number, max(LEAST_HELD, number // 10))
        images = self.images.take(torch.cat([chosen, held]))
        scenes = gray(images, torch.arange(len(images)))
        noise = stream(1, "pairs", kind.name, number)
        return embedded(self.operator, self.masks(kind), scenes, noise), images, scenes


def apart(images: Images, number: int, held: int) -> tuple[Tensor, Tensor]:
    """Places of ``number`` pictures, and of ``held`` others that share no group with them."""
    groups = torch.arange(len(images)) if images.groups is None else images.groups
    known = torch.unique(groups)
    order = known[torch.randperm(len(known), generator=stream(1, "attacker"))]
    last = order[-max(1, len(order) // 10) :]
    ours = torch.isin(groups, last)
    shuffled = torch.randperm(len(images), generator=stream(1, "attacker", "pictures"))
    learned, others = shuffled[~ours[shuffled]], shuffled[ours[shuffled]]
    if len(learned) < number or len(others) < held:
        raise typer.BadParameter(
            f"{len(images)} pictures are too few for {number} pairs and {held} to choose by: "
            "use fewer pairs, or more data"
        )
    return learned[:number], others[:held]


def attack(
    attacked: Attacked, kind: Kind, number: int, truth: Tensor, design: DesignName
) -> Values:
    """One cell."""
    embeddings, _, scenes = attacked.pairs(kind, number)
    learned = PlaintextPairs(embeddings[:number], scenes[:number])
    check = PlaintextPairs(embeddings[number:], scenes[number:])
    fitted = best_generator(learned, check, DESIGNS[design], trials(number, design))
    noise = stream(1, "pairs", "test", kind.name)
    seen = embedded(attacked.operator, attacked.masks(kind), truth, noise)
    found = likeness(fitted.estimate(seen), truth)
    return {**found, "trial": asdict(fitted.trial), "epochs": fitted.epochs}


def tell(
    found: dict[str, Values], kinds: list[Kind], numbers: list[int], guess: list[float]
) -> None:
    """Print the table beside the paper's, and which differences are proven."""
    paper = published()
    for name, cell in found.items():
        said = f"SSIM {mean(cell['ssim'])}, {cell['epochs']} epochs at {cell['trial']['rate']:g}"
        key = f"generator_psnr_{name}"
        row(key, mean(cell["psnr"]), paper.get(key), said)
    print(f"the mean picture of the training set: {mean(guess)} dB")
    for fewer, more in pairwise(numbers):
        for kind in kinds:
            one, other = (found[f"{kind.name}_{number}"]["psnr"] for number in (more, fewer))
            print(f"{kind.name}: {more} pairs over {fewer}: {proven(difference(one, other))}")
    for few, many in (("1", "10"), ("10", "100"), ("10random", "10")):
        for number in numbers:
            if {f"{few}_{number}", f"{many}_{number}"} <= found.keys():
                gain = difference(*(found[f"{name}_{number}"]["psnr"] for name in (few, many)))
                print(f"{number} pairs: masks {few} over {many}: {proven(gain)}")


def as_figures(found: dict[str, Values], guess: list[float]) -> dict[str, float]:
    """Figures by name."""
    values = {"generator_psnr_mean_picture": round(mean(guess).value, 2)}
    for name, cell in found.items():
        values[f"generator_psnr_{name}"] = round(mean(cell["psnr"]).value, 2)
        values[f"generator_psnr_half_{name}"] = round(mean(cell["psnr"]).half, 2)
        values[f"generator_ssim_{name}"] = round(mean(cell["ssim"]).value, 3)
    return values
