"""From a folder of pictures to a served camera: three commands, and how often it is right then.

``python -m benchmarks.training.own_pictures --figures benchmarks/results/data.json``

The pictures are those that ``veilcam-train draw`` draws. Every picture of the test folder is held
before the simulated camera of the daemon, and the label that a client gets is counted; the fit has
seen none of them.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer
from benchmarks.figures import FiguresOption, record
from PIL import Image

from veilcam_client import Camera
from veilcam_server.demo.daemon import running
from veilcam_training.experiments.card_page import bare, panels_of

app = typer.Typer(pretty_exceptions_enable=False)


ACROSS = 8
"""Pictures of each shape that are shown."""


def draw(place: Path, said: Mapping[Path, str]) -> None:
    """Test pictures and the label that the camera gave each; wrong ones in red."""
    shapes = sorted({path.parent.name for path in said})
    figure, panels = panels_of(len(shapes), ACROSS, (0.9, 1.05))
    for name, row in zip(shapes, panels, strict=True):
        some = [path for path in said if path.parent.name == name][:ACROSS]
        for axes, path in zip(row, some, strict=True):
            with Image.open(path) as shown:
                axes.imshow(shown, cmap="gray", vmin=0, vmax=255)
            bare(axes)
            wrong = said[path] != name
            axes.set_title(said[path], fontsize=8, color="#c00000" if wrong else "#222222")
    figure.savefig(place, dpi=150)


@app.command()
def main(
    count: Annotated[int, typer.Option(help="Pictures to draw.")] = 2000,
    seed: Annotated[int, typer.Option(help="Of the pictures; the mask's is secret.")] = 1,
    picture: Annotated[Path | None, typer.Option(help="Some answers, as a PNG file.")] = None,
    figures: FiguresOption = None,
) -> None:
    """Draw, fit, serve; then ask the daemon about every test picture."""
    with TemporaryDirectory() as name:
        folder, bundle = Path(name, "shapes"), Path(name, "shapes.veilcam")
        train = str(Path(sys.executable).with_name("veilcam-train"))
        commands = [
            (train, "draw", str(folder), "--count", str(count), "--seed", str(seed)),
            (train, "fit", "--data", str(folder), "--out", str(bundle)),
        ]
        for command in commands:
            subprocess.run(command, check=True)
        shown = sorted((folder / "test").rglob("*.png"))
        with running(bundle, shown[0], Path(name), "--scene-api") as url, Camera(url) as camera:
            said = {}
            for path in shown:
                camera.simulation.hold_scene(path.read_bytes())
                said[path] = camera.classify().label
        command = (train, "predict", str(bundle), *map(str, shown))
        told = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
        if picture is not None:
            draw(picture, said)
    right = sum(label == path.parent.name for path, label in said.items())
    accuracy = 100 * right / len(shown)
    print(f"{right} of {len(shown)} right: {accuracy:.2f} %")
    labels = [line.split("\t")[1] for line in told.splitlines()]
    agreement = sum(a == b for a, b in zip(labels, said.values(), strict=True)) / len(shown)
    print(f"predict and the daemon agree on {100 * agreement:.2f} %")
    record(
        figures,
        {
            "folder_accuracy": accuracy,
            "folder_commands": len(commands) + 1,
            "predict_agreement": agreement,
        },
    )


if __name__ == "__main__":
    app()
