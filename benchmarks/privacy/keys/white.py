"""White embeddings of thousands of masks: collected, and attacked without any key."""

from __future__ import annotations

import json
import statistics
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, cast, get_args

import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.keys.options import (
    BundleOption,
    EpochsOption,
    SeedOption,
    WorkArgument,
    fresh_bundle,
    shown_progress,
)
from benchmarks.privacy.keys.released import CHUNK, Camera, chunk_path, collect, load, write_chunk
from benchmarks.privacy.keys.rows import attack
from benchmarks.privacy.keys.scenes import Question, load_scenes

from veilcam_server.demo_data import FRESH
from veilcam_training.attacks.intervals import ALPHA, Gain, Verdict, holm
from veilcam_training.attacks.networks import FAMILIES

QUESTIONS: tuple[Question, ...] = get_args(Question)
_SHAPE = "shape.json"


def collect_command(
    work: WorkArgument,
    *,
    masks: Annotated[int, typer.Option(min=1, help="Each of one use.")] = 25_000,
    bundle: BundleOption = FRESH,
    data: Annotated[
        Path | None, typer.Option(help="Folder of MNIST's files; by default the daemon's digits.")
    ] = None,
    faces: Annotated[Path | None, typer.Option(help="Folder that holds faces.npz.")] = None,
    rows: Annotated[int | None, typer.Option(help="Of an embedding; the bundle's.")] = None,
    columns: Annotated[int | None, typer.Option(help="Of an embedding; the bundle's.")] = None,
    seed: SeedOption = 1,
    figures: FiguresOption = None,
) -> None:
    """Draw masks, prepare them as the daemon does, and keep the white embeddings of scenes."""
    contents = fresh_bundle(bundle)
    if (rows is None) != (columns is None):
        raise typer.BadParameter("--rows and --columns go together: give both")
    camera = Camera(contents, None if rows is None or columns is None else (rows, columns))
    shape, embedding = contents.scene.shape, camera.bundle.embedding
    scenes = load_scenes(shape, data, faces)
    work.mkdir(parents=True, exist_ok=True)
    said = {"shape": embedding.shape, "classes": scenes.classes, "seed": seed}
    _same_as_before(work / _SHAPE, said)
    seconds: list[float] = []
    with shown_progress() as progress:
        task = progress.add_task("masks", total=masks)
        for number in range(-(-masks // CHUNK)):
            path = chunk_path(work, number)
            if not path.exists():
                made = collect(camera, scenes, masks=CHUNK, seed=1000 * seed + number)
                seconds += made["seconds"].astype(float).tolist()
                write_chunk(path, made)
            progress.update(task, completed=CHUNK * (number + 1))
    if seconds:
        typical = 1e3 * statistics.median(seconds)
        print(f"{len(seconds)} masks, {typical:.1f} ms of a core each with all their scenes")
        record(figures, {"white_mask_ms": round(typical, 1)})


def _same_as_before(path: Path, said: dict[str, object]) -> None:
    text = json.dumps(said)
    if path.exists() and json.loads(path.read_text()) != json.loads(text):
        raise typer.BadParameter(f"{path} says that other captures were collected here")
    path.write_text(text)


def attack_command(
    work: WorkArgument,
    *,
    masks: Annotated[int, typer.Option(min=100, help="So many of those collected.")] = 25_000,
    row: Annotated[
        list[str] | None, typer.Option(help=f"Of {', '.join(QUESTIONS)}; all by default.")
    ] = None,
    epochs: EpochsOption = 8,
    seed: SeedOption = 1,
    figures: FiguresOption = None,
) -> None:
    """Attack collected embeddings; each row is kept in the folder, and not attacked twice."""
    if row and figures is not None:
        raise typer.BadParameter("figures are of all rows, which share one error: leave out --row")
    said = json.loads((work / _SHAPE).read_text())
    classes = cast("dict[Question, int]", said["classes"])
    asked = [each for each in QUESTIONS if each in classes and (not row or each in row)]
    gains: dict[str, Gain] = {}
    with shown_progress() as progress:
        task = progress.add_task("rows", total=len(asked) * len(FAMILIES))
        for question in asked:
            released = load(work, question, masks)
            for family in FAMILIES:
                name = f"{question} by {family}"
                kept = work / f"white-{masks}-{epochs}-{seed}" / name
                if not kept.exists():
                    gain = attack(
                        *(question, family, released, classes[question]),
                        shape=tuple(said["shape"]),
                        epochs=epochs,
                        seed=seed,
                    )
                    kept.parent.mkdir(exist_ok=True)
                    kept.write_text(json.dumps(asdict(gain)))
                gains[name] = Gain(**json.loads(kept.read_text()))
                print(f"{name}: {gains[name].shown:.4g}", flush=True)
                progress.advance(task)
    verdicts = holm(gains)
    tell(verdicts)
    record(figures, white_figures(verdicts))


def tell(verdicts: dict[str, Verdict]) -> None:
    """Print every row."""
    print(f"{'row':24}{'shown':>9}{'gain':>9}{'error':>9}{'upper':>9}{'bar':>7}  holds")
    for name, verdict in verdicts.items():
        gain = verdict.gain
        print(
            f"{name:24}{gain.shown:9.4f}{gain.value:9.4f}{gain.error:9.4f}{verdict.upper:9.4f}"
            f"{gain.bar:7.2f}  {'yes' if verdict.holds else 'NO'}  n = {gain.count}"
        )
    print(f"upper ends are one-sided; all rows share an error of {ALPHA:.0%} (Holm)")


def white_figures(verdicts: dict[str, Verdict]) -> dict[str, float]:
    """Figures of each question: of its best attacker, and the highest upper end."""
    values: dict[str, float] = {}
    for question in QUESTIONS:
        of_it = [each for name, each in verdicts.items() if name.startswith(f"{question} ")]
        if not of_it:
            continue
        upper = max(each.upper for each in of_it)
        best = max(of_it, key=lambda each: each.gain.value).gain
        if question in ("presence", "linkage"):
            values[f"white_{question}_auc"] = round(best.shown, 4)
            values[f"white_{question}_auc_upper"] = round(0.5 + upper, 4)
        else:
            values[f"white_{question}_advantage"] = round(best.value, 3)
            values[f"white_{question}_advantage_upper"] = round(upper, 3)
    return values
