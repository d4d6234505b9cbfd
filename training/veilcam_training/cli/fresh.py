"""``veilcam-train fit-fresh`` and ``frame``: masks that nobody has used before."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import torch
import typer
from rich.console import Console

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.decoding import write_frame
from veilcam_training.bundle import read_bundle, write_bundle
from veilcam_training.config.fresh import TASKS, find_settings
from veilcam_training.data import open_source
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.fresh import as_fresh_bundle, run_fresh
from veilcam_training.files import check_file, check_folder
from veilcam_training.trainer.callbacks import FitProgress, make_progress


def fit_fresh_command(
    *,
    data: Annotated[Path, typer.Option(help="Folder that holds the data set's files.")],
    out: Annotated[Path, typer.Option(help="Bundle to write, *.veilcam.")],
    task: Annotated[str, typer.Option(help=f"One of {', '.join(TASKS)}.")] = "mnist_24x32",
    device: Annotated[str, typer.Option(help="The camera's name in its key schedule.")] = "camera",
    epochs: Annotated[int | None, typer.Option(help="Instead of the task's.")] = None,
    seed: Annotated[int, typer.Option(help="Of every random number.")] = 0,
    masks: Annotated[
        int | None, typer.Option(min=1, help="Masks to test on; one a capture by default.")
    ] = None,
    work: Annotated[
        Path | None, typer.Option(help="Folder for checkpoints: resumes what is in it.")
    ] = None,
    threads: Annotated[int, typer.Option(min=1)] = 1,
) -> None:
    """Fit one classifier to a stream of fresh masks; test it on unseen ones; write a bundle."""
    torch.set_num_threads(threads)
    check_file("--out", out, ".veilcam")
    if work is not None:
        check_folder("--work", work)
    changes = {"seed": seed} if epochs is None else {"seed": seed, "epochs": epochs}
    settings, camera, console = find_settings(task, **changes), Camera(), Console()
    source = open_source(settings.data, data)
    with make_progress(console) as progress:
        bar = FitProgress(progress, task, settings.epochs)
        outcome = run_fresh(settings, source, camera, masks=masks, work=work, observers=[bar])
    write_bundle(out, as_fresh_bundle(outcome, source, camera, device=device))
    console.print(
        f"test {100 * outcome.test.accuracy:.2f} % on {outcome.test.masks} unseen masks "
        f"({100 * outcome.wrong_key.accuracy:.2f} % with the wrong key)\n"
        f"wrote {out} ({out.stat().st_size / 1e6:.2f} MB)"
    )


def frame_command(
    bundle: Annotated[Path, typer.Argument(help="Bundle of mode fresh.")],
    out: Annotated[Path, typer.Argument(help="Frame to write, *.safetensors.")],
) -> None:
    """Write what decoding elsewhere needs besides the secret; none of it is secret."""
    contents = read_bundle(bundle)
    if contents.fresh is None:
        raise TrainingError(f"{bundle} holds pairs: use a bundle of mode fresh")
    check_file("OUT", out, ".safetensors")
    write_frame(out, contents.fresh.frame(contents.camera, contents.scene, contents.embedding))
    Console().print(f"wrote {out}; the camera's label is {contents.fresh.device!r}")
