"""Figures of the guard, and their chart.

    python -m benchmarks.guard verdicts --figures benchmarks/results/guard.json
    python -m benchmarks.guard sound --figures benchmarks/results/guard.json
    python -m benchmarks.guard lost --figures benchmarks/results/guard.json
    python -m benchmarks.guard rest --figures benchmarks/results/guard.json
    python -m benchmarks.guard speed --figures benchmarks/results/guard.json
    python -m benchmarks.guard chart docs/images/guard.png

Each is one command, so that what was broken off is done again alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated
from unittest.mock import patch

import numpy as np
import typer
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.figures import FiguresOption, record
from benchmarks.guard import served, verdicts
from benchmarks.guard.world import FAULTS, shipped
from benchmarks.rig import work_folder
from veilcam_server.camera import guard
from veilcam_server.demo_data import BUNDLE

app = typer.Typer(add_completion=False, no_args_is_help=True)
INTERVALS = (0.0, 0.3, 1.0, 3.0, 10.0, 30.0)
"""Guard intervals of the chart [s]."""


@app.command("verdicts")
def measure_verdicts(changes: int = 1000, figures: FiguresOption = None) -> None:
    """Break panels on a clock of their own, in steady and flickering light."""
    random = np.random.default_rng(1)
    optics = verdicts.optics_of(random)
    found = verdicts.faults(optics, random, changes, verdicts.LIGHTS)
    for key, count in sorted(found.items()):
        typer.echo(f"{key}: {count}")
    tried = changes * len(FAULTS)
    wrong = verdicts.answered(found)
    typer.echo(f"{wrong} of {tried} answered")
    for light, share in verdicts.dark_curve(optics, random, changes // 10).items():
        typer.echo(f"light {light:.4f}: {share:.2f} answered as too dark")
    record(figures, {"faults_tried": tried, "faults_answered": wrong})


@app.command("sound")
def measure_sound(
    cameras: int = 300, changes: int = 300_000, figures: FiguresOption = None
) -> None:
    """Take captures of sound cameras, rendered in steady light, then drawn under lamps."""
    random = np.random.default_rng(2)
    sound = verdicts.Sound(random, cameras)
    steady = sound.changes(10 * cameras, (0.0,))
    drawn = sound.changes(changes, (0.1, 3.0))
    for came in (steady, drawn):
        typer.echo(f"{dict(came)}")
    accused = sum(
        count for came in (steady, drawn) for name, count in came.items() if "acc" in name
    )
    with patch.object(guard, "ACCUSED", 2):
        twice = sound.changes(changes // 10, (0.1, 3.0))
    typer.echo(f"with two verdicts in a row: {dict(twice)}")
    typer.echo(
        f"worst ratio {sound.worst:.3f}: {sound.worst_camera}; {sound.unwatchable} unwatchable"
    )
    typer.echo(f"upper ends (95 %): {3 / cameras:.2g} a camera, {3 / changes:.2g} a change")
    record(
        figures,
        {"sound_cameras": cameras, "sound_accused": accused, "sound_worst_ratio": sound.worst},
    )


@app.command("lost")
def measure_lost(captures: int = 200, figures: FiguresOption = None) -> None:
    """Lose transfers of pairs, before masks were written twice after an opaque frame, and since."""
    _, masks = shipped(BUNDLE, np.random.default_rng(3), 6)
    wrong = {True: 0, False: 0}
    for every in (9, 13):
        for guarded in (False, True):
            count = served.lost_transfers(every, captures, masks, guarded=guarded)
            typer.echo(
                f"lost={every}, {'since' if guarded else 'before'}: {count} of {every * captures}"
            )
            wrong[guarded] += count
    record(figures, {"lost_wrong_before": wrong[False], "lost_wrong_after": wrong[True]})


@app.command("rest")
def measure_rest(
    tries: int = 100,
    minutes: float = 60.0,
    bundle: Path = BUNDLE,
    figures: FiguresOption = None,
) -> None:
    """Break panels of daemons with a mask for each capture, over REST; five daemons at once."""
    with work_folder() as folder:
        found = served.all_rest_faults(folder, bundle, tries, minutes)
    for fault, came in found.items():
        typer.echo(f"{fault}: {dict(came)}")
    wrong = sum(
        count for came in found.values() for name, count in came.items() if "answered" in name
    )
    record(
        figures,
        {
            "rest_faults_tried": sum(came["tried"] for came in found.values()),
            "rest_faults_answered": wrong,
        },
    )


@app.command("speed")
def measure_speed(
    seconds: float = 60.0, captures: int = 400, figures: FiguresOption = None
) -> None:
    """Compare rates with the guard and without, and latencies of two scenes."""
    with work_folder() as folder:
        found = dict(served.rates(folder, seconds))
        area, took, came = served.latencies(folder, captures)
    found["latency_auc"] = area
    for name, value in found.items():
        typer.echo(f"{name}: {value:.3f}")
    typer.echo(f"latencies [s]: {np.quantile(took, (0.05, 0.5, 0.95)).round(3)}; {dict(came)}")
    record(figures, {name: value for name, value in found.items() if "a_second" not in name})


@app.command("chart")
def draw(path: Annotated[Path, typer.Argument(help="Picture to write.")], tries: int = 300) -> None:
    """Draw the time to detection, and captures a second, against the guard interval."""
    random = np.random.default_rng(4)
    optics = verdicts.optics_of(random)[1]
    times, rate = [], []
    for every in INTERVALS:
        found, captures = verdicts.detection(optics, random, every, tries)
        times.append(np.quantile(found, (0.5, 0.95)))
        rate.append(captures)
        typer.echo(f"{every} s: {times[-1].round(2)} s, {captures:.1f} a second")
    figure = Figure(figsize=(6.4, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    places = range(len(INTERVALS))
    for place, (name, style) in enumerate((("half of the faults", "o-"), ("95 %", "s--"))):
        left.plot(places, [each[place] for each in times], style, label=name, color="#1f6fb5")
    left.set(ylabel="time to detection [s]", yscale="log")
    left.set_yticks((2, 5, 10, 20), ("2", "5", "10", "20"), minor=False)
    left.minorticks_off()
    left.legend(frameon=False)
    right.plot(places, rate, "o-", color="#d1495b")
    right.set(ylabel="captures a second", ylim=(0, None))
    for axes in (left, right):
        axes.set_xticks(places, [f"{every:g}" for every in INTERVALS])
        axes.set_xlabel("guard interval [s]")
        axes.grid(color="#e4e4e4")
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    app()
