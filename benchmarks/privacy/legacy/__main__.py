"""Attacks on embeddings as they once left: ``raw``, ``flat``, and ``white`` with its length.

``python -m benchmarks.privacy.legacy all --data data/mnist --faces data/faces --work runs/legacy
--figures benchmarks/results/privacy.json``, or one row by its name.

They are the measure of the attacks themselves: an attack that does not read these reads nothing.
Embeddings are 24 x 32; noise is that of 40 dB; the light interferes further than the attacker's
operator says. Every figure is the mean of five masks or of three seeds; with ``--work`` a run that
is done is not done again.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.keys.options import shown_progress
from benchmarks.privacy.legacy.rows import ROWS, Found
from benchmarks.privacy.legacy.setting import Setting

app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def main(
    row: Annotated[str, typer.Argument(help=f"all, or one of {', '.join(ROWS)}.")],
    *,
    data: Annotated[Path, typer.Option(help="Folder of MNIST's files.")],
    faces: Annotated[Path | None, typer.Option(help="Folder that holds faces.npz.")] = None,
    work: Annotated[Path | None, typer.Option(help="Folder that keeps each run.")] = None,
    figures: FiguresOption = None,
) -> None:
    """Attack old forms, and say what is to be reached on them."""
    if row != "all" and row not in ROWS:
        raise typer.BadParameter(f"{row} is no row: use all, or one of {', '.join(ROWS)}")
    names = list(ROWS) if row == "all" else [row]
    setting = Setting(data, faces)
    with shown_progress() as progress:
        task = progress.add_task("runs", total=sum(ROWS[name].runs for name in names))
        for name in names:
            begun, runs = time.process_time(), []
            for number in range(ROWS[name].runs):
                runs.append(measured(setting, name, number, work))
                progress.advance(task)
            means = {each: round(sum(run[each] for run in runs) / len(runs), 4) for each in runs[0]}
            print(f"{name}: {time.process_time() - begun:.0f} s of a core", flush=True)
            tell(name, means, runs)
            record(figures, means)


def tell(name: str, means: Found, runs: list[Found]) -> None:
    """Print figures beside what is to be reached."""
    for each, value in means.items():
        least = ROWS[name].reach[each]
        verdict = "reached" if value >= least else "NOT REACHED"
        single = ", ".join(f"{run[each]:.4g}" for run in runs)
        print(f"  {each}: {value:.4g} of {least:g}, {verdict} ({single})", flush=True)


def measured(setting: Setting, name: str, number: int, work: Path | None) -> Found:
    """Figures of one run, from the folder where it was done before."""
    kept = None if work is None else work / f"{name}-{number}.json"
    if kept is not None and kept.exists():
        found: Found = json.loads(kept.read_text())
        return found
    found = ROWS[name].measure(setting, number)
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(".part")
        part.write_text(json.dumps(found))
        part.replace(kept)
    return found


if __name__ == "__main__":
    torch.set_num_threads(1)
    app()
