"""``veilcam-train attack``: what attackers gain on a bundle, and the card that says so."""

from pathlib import Path
from typing import Annotated

import torch
import typer
from rich.console import Console
from rich.progress import Progress, TaskID
from rich.table import Table

from veilcam_optics.files import write_whole
from veilcam_training.attacks.card.study import FULL, QUICK, Tell
from veilcam_training.bundle import CardRow, PrivacyCard, add_card, read_bundle
from veilcam_training.cli.options import Threads
from veilcam_training.data import Images, open_source
from veilcam_training.data.sample import shipped_digits
from veilcam_training.errors import TrainingError
from veilcam_training.files import check_folder
from veilcam_training.trainer.callbacks import make_progress

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Attack bundles, and say what came of it.",
)
console = Console(soft_wrap=True, highlight=False)
SEED = 1


@app.command()
def report(
    bundle: Annotated[Path, typer.Argument(help="A bundle, *.veilcam.")],
    *,
    quick: Annotated[
        bool, typer.Option("--quick", help="Few captures and light attackers: minutes.")
    ] = False,
    data: Annotated[
        Path | None,
        typer.Option("--data", help="Folder of the bundle's data set; by default, shipped digits."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for card.html, card.json and what is to be resumed."),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the card that was begun in --out.")
    ] = False,
    mode: Annotated[
        str | None,
        typer.Option("--mode", help="fresh, random or pairsN, in place of the bundle's masks."),
    ] = None,
    form: Annotated[
        str | None,
        typer.Option("--form", help="raw or sealed; sealed of fresh masks, raw of others."),
    ] = None,
    faces: Annotated[
        Path | None,
        typer.Option("--faces", help="Folder that holds faces.npz: notes beside T8 and T9."),
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="Of the attacks; the camera's keys are its own.")
    ] = SEED,
    write: Annotated[
        bool, typer.Option("--write", help="Lay the card into the bundle, which is replaced.")
    ] = False,
    threads: Threads = 1,
) -> None:
    """Attack a bundle in ten ways, and make its privacy card."""
    # Slow to import.
    from veilcam_training.attacks.card.report import Work, make_card  # noqa: PLC0415
    from veilcam_training.experiments.card_page import draw_pictures, write_page  # noqa: PLC0415

    if resume and out is None:
        raise TrainingError("--resume goes on with what is in a folder: give --out FOLDER")
    if write and mode is not None:
        raise TrainingError("--write is for a card of the bundle's own masks: leave out --mode")
    if out is not None:
        check_folder("--out", out)
    if threads is not None:
        torch.set_num_threads(threads)
    contents = read_bundle(bundle)
    if write and contents.owner is not None:
        raise TrainingError(f"{bundle} is signed: give it the card first, then sign it")
    images, name = _images(contents.task, data)
    with make_progress(Console(stderr=True)) as progress:
        card, study = make_card(
            contents,
            images,
            mode=mode,
            form=form,
            data=name,
            plan=QUICK if quick else FULL,
            seed=seed,
            work=Work(None if out is None else out / "work", resume),
            tell=teller(progress),
            faces=faces,
        )
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            page = write_page(card, draw_pictures(study))
            write_whole(out / "card.html", page.encode(), private=False)
            write_whole(out / "card.json", card.model_dump_json(indent=1).encode(), private=False)
    _show(card)
    if out is not None:
        console.print(f"wrote {out / 'card.html'} and card.json")
    if write:
        add_card(bundle, card)
        console.print(f"{bundle} carries the card; its digest is {read_bundle(bundle).digest[:12]}")


def teller(progress: Progress, mode: str = "") -> Tell:
    """Show progress: a bar for each thing that is done.

    Args:
        progress: progress to add bars to.
        mode: mode that is attacked, where there are several.
    """
    tasks: dict[str, TaskID] = {}

    def tell(what: str, done: int, total: int) -> None:
        if what not in tasks:
            tasks[what] = progress.add_task(f"{mode} {what}".strip(), total=total, note="")
        progress.update(tasks[what], completed=done)

    return tell


def _images(task: str, data: Path | None) -> tuple[Images, str]:
    if data is None:
        return shipped_digits(), "5,000 digits of MNIST, as they come with veilcamd"
    source = open_source(task, data)
    if source.colour:
        raise TrainingError(f"{task} is in colour and cannot be attacked: use a gray data set")
    images = source.training()
    return images, f"{source.name}, {len(images):,} pictures"


def _show(card: PrivacyCard) -> None:
    table = Table("threat", "", "figure", "interval", "threshold", "outcome", "worst attacker")
    for row in card.rows:
        table.add_row(
            row.threat,
            row.title,
            f"{row.figure:.3g} {row.unit}",
            f"{'>=' if row.threat == 'T0' else '<='} {row.end:.3g}",
            _threshold(row),
            row.outcome,
            row.attack,
        )
    console.print(table)
    look = ", quick" if card.quick else ""
    console.print(f"{card.outcome}: {card.mode}, {card.form}{look}, {card.minutes:.1f} minutes")


def _threshold(row: CardRow) -> str:
    return "" if row.outcome == "NOT CLAIMED" else f"{row.threshold:g}"
