"""``veilcam-train``: fit masks and classifiers, and write them as bundles."""

import sys
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.errors import OpticsError
from veilcam_training.bundle import BundleError, write_bundle
from veilcam_training.cli.adapt import adapt_command
from veilcam_training.cli.attack import app as attack_app
from veilcam_training.cli.bundle import app as bundle_app
from veilcam_training.cli.bundle import light_line, show_hiding
from veilcam_training.cli.export import export_command
from veilcam_training.cli.fit import fit_command
from veilcam_training.cli.fresh import frame_command
from veilcam_training.cli.options import (
    AllowVisible,
    Batch,
    Classifier,
    Config,
    Dataset,
    Device,
    EncoderName,
    Epochs,
    Folder,
    RecipeName,
    Seed,
    Shape,
    SkipDamaged,
    Threads,
    Work,
    given,
    opened,
    prepare,
    show_summary,
)
from veilcam_training.cli.predict import predict_command
from veilcam_training.config.files import load_settings
from veilcam_training.data import recognise
from veilcam_training.data.download import REMOTES, download
from veilcam_training.data.drawn import SHAPES, draw_folder
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.executors import make_executor
from veilcam_training.experiments.fit import settle_seed
from veilcam_training.experiments.keyring import fit_keyring
from veilcam_training.files import check_file, check_folder
from veilcam_training.trainer.callbacks import FitProgress, make_progress

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None)
console = Console()


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"veilcam-train {version('veilcam')}")
        raise typer.Exit


@app.callback()
def veilcam_train(
    *,
    _: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """Train lensless cameras: mask and classifier together."""


WorkerCount = Annotated[
    int | None,
    typer.Option("--workers", min=1, help="Processes, each of one thread; 1 by default."),
]
RayAddress = Annotated[
    str | None, typer.Option("--ray", help="HOST:PORT of a Ray cluster, or local to start one.")
]


app.command("fit")(fit_command)


@app.command("keyring")
def keyring_command(
    *,
    data: Folder,
    out: Annotated[Path, typer.Option("--out", help="Bundle to write, *.veilcam.")],
    pairs: Annotated[int, typer.Option("--pairs", min=1, help="How many masks.")] = 5,
    config: Config = None,
    dataset: Dataset = None,
    classifier: Classifier = None,
    encoder: EncoderName = None,
    embedding: Shape = None,
    recipe: RecipeName = None,
    epochs: Epochs = None,
    batch: Batch = None,
    allow_visible: AllowVisible = False,
    seed: Seed = None,
    work: Work = None,
    skip_damaged: SkipDamaged = False,
    device: Device = "auto",
    threads: Threads = None,
    processes: WorkerCount = None,
    address: RayAddress = None,
) -> None:
    """Fit several pairs of mask and classifier, each from its own seed, into one bundle."""
    chosen = given(
        data=dataset,
        classifier=classifier,
        encoder=encoder,
        embedding=embedding,
        seed=seed,
        recipe=recipe,
        epochs=epochs,
        batch=batch,
        hidden=False if allow_visible else None,
    )
    load = partial(load_settings, config, chosen, found=recognise(data))
    settings, source = opened(load, data.resolve(), skip_damaged=skip_damaged)
    place = prepare(device, threads)
    check_file("--out", out, ".veilcam")
    if work is not None:
        check_folder("--work", work)
    workers = make_executor(processes, address, threads=threads, gpus=int(place.type == "cuda"))
    show_summary(console, source)
    here = address is None and processes in (None, 1)  # no bar moves from another process
    with make_progress(console) as progress:
        done = progress.add_task("pairs", total=pairs, note="")
        bundle = fit_keyring(
            settle_seed(settings, work),
            pairs,
            source,
            Camera(),
            device=place,
            work=None if work is None else work.resolve(),  # a worker may stand elsewhere
            workers=workers,
            observe=lambda index: (
                [FitProgress(progress, f"pair {index + 1} of {pairs}")] if here else []
            ),
            fitted=lambda *_: progress.advance(done),
        )
    write_bundle(out, bundle)
    console.print(light_line(bundle.light, bundle.transfer_error))
    show_hiding(console, bundle)
    if bundle.accuracy is not None:
        console.print(
            f"{pairs} pairs, mean accuracy {100 * bundle.accuracy.value:.2f} % "
            f"on {bundle.accuracy.test_set} ({bundle.accuracy.samples})"
        )
    console.print(f"wrote {out} ({out.stat().st_size / 1e6:.2f} MB)")


app.command("frame")(frame_command)
app.command("adapt")(adapt_command)
app.command("export")(export_command)
app.command("predict")(predict_command)
app.add_typer(bundle_app, name="bundle")
app.add_typer(attack_app, name="attack")


@app.command("draw")
def draw_command(
    folder: Annotated[Path, typer.Argument(help="New folder to put the pictures into.")],
    count: Annotated[int, typer.Option(help="How many, a fifth of them of each shape.")] = 2000,
    seed: Annotated[int, typer.Option(min=0, help="The same seed draws the same ones.")] = 0,
) -> None:
    """Draw pictures of five shapes: a data set to try a fit with, where there is no other."""
    check_folder("FOLDER", folder)
    draw_folder(folder, count, seed)
    console.print(f"drew {', '.join(SHAPES)} into {folder}/train and {folder}/test")


@app.command("download")
def download_command(
    name: Annotated[str, typer.Argument(help=f"One of {', '.join(REMOTES)}.")],
    data: Annotated[Path, typer.Option("--data", help="Folder to put the files into.")],
) -> None:
    """Fetch a public data set and check it against its published digests."""
    check_folder("--data", data)
    download(name, data, console)
    console.print(f"{name} is in {data}")


def main() -> None:
    """Run the command line; what the user can mend is one line on stderr and exit status 1."""
    try:
        app()
    except (TrainingError, OpticsError, BundleError) as error:
        _fail(str(error))


def _fail(message: str) -> NoReturn:
    Console(stderr=True).print(f"error: {message}", markup=False, highlight=False, soft_wrap=True)
    sys.exit(1)
