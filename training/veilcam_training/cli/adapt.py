"""``veilcam-train adapt``: a bundle fine-tuned to one camera."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from veilcam_optics.decoding import read_frame
from veilcam_training.bundle import read_bundle, write_bundle
from veilcam_training.data.measurements import read_measurements
from veilcam_training.errors import require
from veilcam_training.experiments.adapt import adapt_bundle
from veilcam_training.files import check_file

console = Console(soft_wrap=True, highlight=False)


def adapt_command(
    bundle: Annotated[Path, typer.Argument(help="Bundle that the camera uses, *.veilcam.")],
    measurements: Annotated[Path, typer.Argument(help="What 'veilcam collect' wrote with it.")],
    *,
    out: Annotated[Path, typer.Option("--out", help="Bundle to write, *.veilcam.")],
    frame: Annotated[
        Path | None,
        typer.Option(
            "--frame",
            help="Of the camera as it was built, by 'veilcamd calibrate --frame': for fresh masks.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of every random number.")] = 0,
) -> None:
    """Fine-tune a bundle's classifiers to labelled measurements of one camera.

    Masks stay as they are. How freely a classifier is fitted is chosen by measurements that are
    left out in turn; where none of it helps, the classifier is kept.
    """
    check_file("--out", out, ".veilcam")
    require(out.resolve() != bundle.resolve(), "--out is the bundle itself: give another name")
    adapted = adapt_bundle(
        read_bundle(bundle),
        read_measurements(measurements),
        frame=None if frame is None else read_frame(frame),
        seed=seed,
    )
    for number, trial in adapted.chosen.items():
        console.print(f"classifier {number}: weights fitted: {trial.freedom}")
    console.print(
        f"{100 * adapted.before:.1f} % of the measurements were read right, "
        f"{100 * adapted.after:.1f} % are by classifiers that were not fitted to them"
    )
    write_bundle(out, adapted.bundle)
    console.print(f"wrote {out} ({out.stat().st_size / 1e6:.2f} MB), not signed")
