"""Privacy cards of all modes side by side, and how long a quick one takes.

``python -m benchmarks.privacy.card compare --data data/mnist --work runs/cards --pairs k.veilcam``
``python -m benchmarks.privacy.card quick --figures benchmarks/results/privacy.json``
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from rich.console import Console

from veilcam_server.demo_data import BUNDLE, FRESH
from veilcam_training.attacks.card.report import Work, figures_of, make_card
from veilcam_training.attacks.card.study import FULL, QUICK
from veilcam_training.bundle import Bundle, PrivacyCard, read_bundle
from veilcam_training.cli.attack import teller
from veilcam_training.data import Images, open_source
from veilcam_training.data.sample import shipped_digits
from veilcam_training.experiments.card_page import draw_pictures, write_page
from veilcam_training.trainer.callbacks import make_progress

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False)

STORED = (1, 10, 100)
"""Pairs of a keyring."""


@app.command()
def compare(
    *,
    work: Annotated[Path, typer.Option(help="Folder of the cards: goes on with what is in it.")],
    pairs: Annotated[Path, typer.Option(help="Bundle of mode pairs.")] = BUNDLE,
    fresh: Annotated[Path, typer.Option(help="Bundle of mode fresh.")] = FRESH,
    data: Annotated[
        Path | None, typer.Option(help="Folder of MNIST's files; by default, shipped digits.")
    ] = None,
    mode: Annotated[
        list[str] | None, typer.Option(help="Of fresh, random, pairs1, pairs10, pairs100; all.")
    ] = None,
    form: Annotated[str | None, typer.Option(help="In which embeddings leave.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Quick cards.")] = False,
    seed: Annotated[int, typer.Option(min=0)] = 1,
    figures: FiguresOption = None,
) -> None:
    """Make a card of every mode, and record the figure of every row."""
    images, name = shipped_digits(), "digits that come with veilcamd"
    if data is not None:
        images, name = open_source("mnist", data).training(), "mnist"
    for one, bundle in _modes(read_bundle(pairs), read_bundle(fresh)).items():
        if mode and one not in mode:
            continue
        card = _card(bundle, images, name, one, form, work=work / one, quick=quick, seed=seed)
        print(f"{card.mode}, {card.form}: {card.outcome}, {card.minutes:.1f} minutes")
        for row in card.rows:
            print(f"  {row.threat} {row.figure:8.3f} {row.end:8.3f} {row.unit:12} {row.attack}")
        record(figures, {key: round(value, 4) for key, value in figures_of(card).items()})


def _modes(pairs: Bundle, fresh: Bundle) -> dict[str, Bundle]:
    """Modes that there are masks for, with the bundle that has them."""
    stored = {f"pairs{count}": pairs for count in STORED if count <= len(pairs.pairs)}
    return {**stored, "random": pairs, "fresh": fresh}


def _card(
    bundle: Bundle,
    images: Images,
    name: str,
    mode: str,
    form: str | None,
    *,
    work: Path,
    quick: bool,
    seed: int,
) -> PrivacyCard:
    with make_progress(Console(stderr=True)) as progress:
        card, study = make_card(
            bundle,
            images,
            mode=mode,
            form=form,
            data=name,
            plan=QUICK if quick else FULL,
            seed=seed,
            work=Work(work, resume=True),
            tell=teller(progress, mode),
        )
        (work / "card.html").write_text(write_page(card, draw_pictures(study)))
    return card


@app.command()
def quick(
    *,
    bundle: Annotated[Path, typer.Option(help="Any bundle of digits.")] = FRESH,
    figures: FiguresOption = None,
) -> None:
    """Time ``veilcam-train attack report --quick``, from its start to its end."""
    program = str(Path(sys.executable).with_name("veilcam-train"))
    command = [program, "attack", "report", str(bundle), "--quick"]
    begun = time.monotonic()
    subprocess.run(command, check=True)
    minutes = (time.monotonic() - begun) / 60
    print(f"{minutes:.2f} minutes")
    record(figures, {"card_quick_minutes": round(minutes, 2)})


if __name__ == "__main__":
    torch.set_num_threads(1)
    app()
