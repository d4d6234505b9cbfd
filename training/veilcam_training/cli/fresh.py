"""``veilcam-train fit-fresh`` and ``frame``: masks that nobody has used before."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.decoding import write_frame
from veilcam_training.bundle import read_bundle, write_bundle
from veilcam_training.cli.bundle import light_line, show_hiding
from veilcam_training.cli.options import (
    Batch,
    Config,
    Csv,
    Device,
    Epochs,
    Folder,
    Logs,
    Seed,
    SkipDamaged,
    Threads,
    Work,
    check_places,
    given,
    opened,
    prepare,
    show_summary,
    watch,
)
from veilcam_training.config.recipes import TASKS
from veilcam_training.config.settings import load_fresh_settings
from veilcam_training.data import recognise
from veilcam_training.data.base import ReadOnce
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.fit import run_fresh, settle_seed
from veilcam_training.experiments.keyring import as_fresh_bundle, check_fresh
from veilcam_training.files import check_file

console = Console()


def fit_fresh_command(
    *,
    data: Folder,
    out: Annotated[Path, typer.Option(help="Bundle to write, *.veilcam.")],
    config: Config = None,
    task: Annotated[str | None, typer.Option(help=f"One of {', '.join(TASKS)}.")] = None,
    epochs: Epochs = None,
    batch: Batch = None,
    seed: Seed = None,
    masks: Annotated[
        int | None, typer.Option(min=1, help="Masks to test on; 200 by default.")
    ] = None,
    work: Work = None,
    tensorboard: Logs = None,
    csv: Csv = None,
    skip_damaged: SkipDamaged = False,
    device: Device = "auto",
    threads: Threads = 1,
) -> None:
    """Fit one classifier to a stream of fresh masks; test it on unseen ones; write a bundle."""
    place = prepare(device, threads)
    check_places(out, work, tensorboard, csv)
    overrides = given(task=task, seed=seed) | {"recipe": given(epochs=epochs, batch=batch)}
    load = partial(load_fresh_settings, config, overrides, found=recognise(data))
    settings, source = opened(load, data, skip_damaged=skip_damaged)
    source, camera = ReadOnce(source), Camera()
    check_fresh(settings, source, camera)
    show_summary(console, source)
    recipe = settings.recipe
    settings = settle_seed(settings, work)
    name = f"{settings.classifier} fresh {settings.embedding}"
    with watch(console, name, recipe.epochs, logs=tensorboard, table=csv) as callbacks:
        result = run_fresh(
            settings,
            source,
            camera,
            masks=masks,
            device=place,
            work=work,
            callbacks=callbacks,
        )
    fitted = as_fresh_bundle(result, source, camera)
    write_bundle(out, fitted)
    show_hiding(console, fitted)
    console.print(
        f"test {100 * result.accuracy.value:.2f} % on {result.masks} unseen masks "
        f"({100 * result.wrong_key_accuracy:.2f} % decoded with another key)\n"
        f"{light_line(result.light, None)}\n"
        f"wrote {out} ({out.stat().st_size / 1e6:.2f} MB)"
    )


def frame_command(
    bundle: Annotated[Path, typer.Argument(help="Bundle of mode fresh.")],
    out: Annotated[Path, typer.Argument(help="Frame to write, *.safetensors.")],
) -> None:
    """Write what decoding elsewhere needs besides the key of a mask; none of it is secret."""
    contents = read_bundle(bundle)
    if contents.fresh is None:
        raise TrainingError(f"{bundle} holds pairs: use a bundle of mode fresh")
    check_file("OUT", out, ".safetensors")
    write_frame(out, contents.fresh.frame(contents.camera, contents.scene, contents.embedding))
    console.print(f"wrote {out}")
