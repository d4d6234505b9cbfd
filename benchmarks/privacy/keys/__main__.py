"""What embeddings, answers and memory tell whoever has no key. One command a proof.

``python -m benchmarks.privacy.keys collect runs/white --masks 25000 --data data/mnist``
``python -m benchmarks.privacy.keys white runs/white --figures benchmarks/results/keys.json``
"""

from __future__ import annotations

import json
import statistics
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, cast, get_args

import numpy as np
import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.keys.attackers import FAMILIES
from benchmarks.privacy.keys.clear_part import clear_part_gain, columns, differences
from benchmarks.privacy.keys.costs import preparation_times, read_sealed, sealing_times
from benchmarks.privacy.keys.intervals import ALPHA, Gain, Verdict, area, holm
from benchmarks.privacy.keys.past import take_past
from benchmarks.privacy.keys.plant import (
    Picture,
    fresh_daemon,
    planted,
    read_answers,
    released_of,
    two_scenes,
)
from benchmarks.privacy.keys.released import (
    CHUNK,
    Camera,
    Released,
    chunk_path,
    collect,
    load,
    write_chunk,
)
from benchmarks.privacy.keys.rows import attack
from benchmarks.privacy.keys.scenes import Question, Stock, load_scenes
from benchmarks.rig import work_folder
from rich.console import Console
from rich.progress import Progress

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_server.demo_data import FRESH, load_digits
from veilcam_training.bundle import Bundle, read_bundle
from veilcam_training.data import open_source

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False)

Work = Annotated[Path, typer.Argument(help="Folder for what was measured: resumes what is in it.")]
BundleOption = Annotated[Path, typer.Option(help="Bundle of mode fresh.")]
DataOption = Annotated[
    Path | None, typer.Option(help="Folder of MNIST's files; by default the daemon's digits.")
]
FacesOption = Annotated[Path | None, typer.Option(help="Folder that holds faces.npz.")]
SeedOption = Annotated[int, typer.Option(help="Of scenes, noise and folds; keys are the kernel's.")]
EpochsOption = Annotated[int, typer.Option(min=1, help="Most that a network is fitted for.")]
QUESTIONS: tuple[Question, ...] = get_args(Question)
_SHAPE = "shape.json"


@app.command("collect")
def collect_command(
    work: Work,
    *,
    masks: Annotated[int, typer.Option(min=1, help="Each of one use.")] = 25_000,
    bundle: BundleOption = FRESH,
    data: DataOption = None,
    faces: FacesOption = None,
    rows: Annotated[int | None, typer.Option(help="Of an embedding; the bundle's.")] = None,
    columns: Annotated[int | None, typer.Option(help="Of an embedding; the bundle's.")] = None,
    legacy: Annotated[bool, typer.Option(help="Keep lengths, as white once did.")] = False,
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
    said = {"shape": embedding.shape, "classes": scenes.classes, "legacy": legacy, "seed": seed}
    _same_as_before(work / _SHAPE, said)
    seconds: list[float] = []
    with _progress() as progress:
        task = progress.add_task("masks", total=masks)
        for number in range(-(-masks // CHUNK)):
            path = chunk_path(work, number)
            if not path.exists():
                made = collect(
                    camera, scenes, masks=CHUNK, seed=1000 * seed + number, legacy=legacy
                )
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


@app.command()
def white(
    work: Work,
    *,
    masks: Annotated[int, typer.Option(min=100, help="So many of those collected.")] = 25_000,
    row: Annotated[
        list[str] | None, typer.Option(help=f"Of {', '.join(QUESTIONS)}; all by default.")
    ] = None,
    legacy: Annotated[bool, typer.Option(help="Attack old white, with lengths.")] = False,
    epochs: EpochsOption = 8,
    seed: SeedOption = 1,
    figures: FiguresOption = None,
) -> None:
    """Attack collected embeddings; each row is kept in the folder, and not attacked twice."""
    said = json.loads((work / _SHAPE).read_text())
    classes = cast("dict[Question, int]", said["classes"])
    asked = [each for each in QUESTIONS if each in classes and (not row or each in row)]
    gains: dict[str, Gain] = {}
    with _progress() as progress:
        task = progress.add_task("rows", total=len(asked) * len(FAMILIES))
        for question in asked:
            released = load(work, question, masks)
            released = released.with_lengths() if legacy else released
            for family in FAMILIES:
                name = f"{question} by {family}"
                kept = work / f"{'legacy' if legacy else 'white'}-{masks}-{epochs}-{seed}" / name
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
    record(figures, {f"legacy_{k}" if legacy else k: v for k, v in white_figures(verdicts).items()})


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


@app.command()
def answers(
    work: Work,
    form: Annotated[str, typer.Argument(help="sealed or white.")],
    *,
    count: Annotated[int, typer.Option(min=20, help="Captures of each of two scenes.")] = 2000,
    bundle: BundleOption = FRESH,
    epochs: EpochsOption = 8,
    seed: SeedOption = 1,
    figures: FiguresOption = None,
) -> None:
    """Plant a digit and an empty room before a real daemon; tell them apart by its answers."""
    if form not in ("sealed", "white"):
        raise typer.BadParameter("use sealed or white")
    labels = two_scenes(count, seed)
    digit = load_digits().images[0]
    # Not black: a camera that sees nothing at all says that it is too dark.
    empty = np.full_like(digit, 64)
    pictures = [digit if each else empty for each in labels]
    path = work / f"two-{form}-{count}-{seed}.jsonl"
    _plant(path, bundle, form, pictures, labels)
    found, planted_labels = read_answers(path), np.array(labels)
    made = columns(found)
    told = differences(made, planted_labels)
    gain = clear_part_gain(made, planted_labels, epochs=epochs, seed=seed)
    print(f"{form}: {len(found)} answers, {len(made)} columns differ from answer to answer")
    print(f"columns of which the distributions differ: {', '.join(told) or 'none'}")
    print(f"clear part: AUC {gain.shown:.4f}, standard error {gain.error:.4f}, n = {gain.count}")
    waits = np.array([each.waited for each in found])
    wait, error = area(waits, planted_labels == 1)
    print(f"no part of an answer: how long it took, AUC {wait:.4f}, standard error {error:.4f}")
    values = {
        f"clear_part_auc_{form}": round(gain.shown, 4),
        f"clear_part_auc_{form}_error": round(gain.error, 4),
        f"clear_part_differences_{form}": len(told),
    }
    if form == "white":
        presence = released_of(found, planted_labels)
        values |= _white_answers(presence, "presence", 2, epochs, seed)
    record(figures, values)


@app.command()
def digits(
    work: Work,
    *,
    count: Annotated[int, typer.Option(min=20, help="Captures, of a mask each.")] = 2000,
    bundle: BundleOption = FRESH,
    epochs: EpochsOption = 8,
    seed: SeedOption = 1,
    figures: FiguresOption = None,
) -> None:
    """Plant digits before a real daemon that releases white, and attack what it answers."""
    sample, random = load_digits(), np.random.default_rng(seed)
    stock = Stock(sample.images, sample.labels.astype(np.int64))
    drawn = [stock.draw(random) for _ in range(count)]
    pictures = [np.round(255 * scene).astype(np.uint8) for scene, _ in drawn]
    labels = [label for _, label in drawn]
    path = work / f"digits-{count}-{seed}.jsonl"
    _plant(path, bundle, "white", pictures, labels)
    released = released_of(read_answers(path), np.array(labels))
    record(figures, _white_answers(released, "digit", 10, epochs, seed))


def _plant(path: Path, bundle: Path, form: str, pictures: list[Picture], labels: list[int]) -> None:
    receiver = ReceiverKey.generate().public if form == "sealed" else None
    done = len(read_answers(path)) if path.exists() else 0
    if done == len(labels):
        return
    with (
        work_folder() as folder,
        fresh_daemon(bundle, folder, receiver) as daemon,
        _progress() as progress,
    ):
        task = progress.add_task(f"answers, {form}", total=len(labels), completed=done)
        for number in planted(daemon, pictures, labels, path):
            progress.update(task, completed=number)


def _white_answers(
    released: Released, question: Question, classes: int, epochs: int, seed: int
) -> dict[str, float]:
    """Attack white embeddings that came over REST; too few to prove what `white` proves."""
    shape = (released.vectors.shape[-2], released.vectors.shape[-1])
    flat = replace(released, vectors=released.vectors.reshape(len(released.labels), 1, -1))
    gains = {
        f"{question} by {family}": attack(
            question, family, flat, classes, shape=shape, epochs=epochs, seed=seed
        )
        for family in FAMILIES
    }
    verdicts = holm(gains)
    tell(verdicts)
    return {f"rest_{name}": value for name, value in white_figures(verdicts).items()}


@app.command()
def past(
    *,
    captures: Annotated[int, typer.Option(min=1, help="Each behind a mask of its own.")] = 1000,
    bundle: BundleOption = FRESH,
    figures: FiguresOption = None,
) -> None:
    """Take a daemon with its memory and files, and open what it sealed before."""
    with work_folder() as folder, _progress() as progress:
        task = progress.add_task("daemon", total=None)
        findings, size = take_past(
            bundle, folder, captures, lambda what: progress.update(task, description=what)
        )
    left = {name: len(found) for name, found in findings.found.items()}
    print(
        f"{len(findings.opened)} of {captures} earlier captures open; {size / 2**20:.0f} MiB read"
    )
    print("epochs of which a secret was found:", left)
    record(
        figures,
        {"past_opened": len(findings.opened)}
        | {f"past_{name}_found": count for name, count in left.items()},
    )


@app.command()
def times(
    *,
    rounds: Annotated[int, typer.Option(min=1)] = 100,
    bundle: BundleOption = FRESH,
    figures: FiguresOption = None,
) -> None:
    """Time sealing, opening and the preparation of epochs, on one core."""
    contents = fresh_bundle(bundle)
    measurement = np.full(contents.embedding.shape, 0.5, np.float32)
    sealing = sealing_times(contents, measurement, rounds)
    with work_folder() as folder:
        preparing = preparation_times(contents, folder, rounds)
    for name, took in {**sealing, **{f"prepare {k}": v for k, v in preparing.items()}}.items():
        print(f"{name:16}{took:9.3f} ms")
    record(
        figures,
        {
            "seal_open_ms": round(sealing["seal"] + sealing["open"], 3),
            "seal_open_first_ms": round(sealing["seal"] + sealing["open_first"], 3),
            "envelope_ms": round(sealing["envelope"], 3),
            "prepare_sealed_ms": round(preparing["sealed"], 2),
            "prepare_sealed_ratio": round(preparing["sealed"] / preparing["mask"], 3),
        },
    )


@app.command()
def accuracy(
    *,
    data: Annotated[Path, typer.Option(help="Folder of MNIST's files.")],
    images: Annotated[int, typer.Option(min=1, help="Of the test set, a mask each.")] = 10_000,
    bundle: BundleOption = FRESH,
    seed: SeedOption = 1,
    figures: FiguresOption = None,
) -> None:
    """Read sealed digits with a receiver's key, and compare with the daemon's own labels."""
    contents = fresh_bundle(bundle)
    shown = open_source("mnist", data).test()
    shown = shown.take(torch.arange(min(images, len(shown))))
    right = alike = 0
    with _progress() as progress:
        for read in progress.track(read_sealed(contents, shown, seed), total=len(shown)):
            right += read.holder == read.truth
            alike += read.holder == read.daemon
    print(f"{100 * right / len(shown):.2f} % right, {alike} of {len(shown)} as the daemon says")
    record(
        figures,
        {
            "fresh_accuracy_sealed": round(100 * right / len(shown), 2),
            "fresh_sealed_as_daemon": round(alike / len(shown), 6),
        },
    )


def _progress() -> Progress:
    return Progress(console=Console(stderr=True))


def fresh_bundle(path: Path) -> Bundle:
    """Read a bundle of mode fresh."""
    contents = read_bundle(path)
    if contents.fresh is None:
        raise typer.BadParameter(f"{path} is of mode pairs: use one of mode fresh")
    return contents


if __name__ == "__main__":
    torch.set_num_threads(1)
    app()
