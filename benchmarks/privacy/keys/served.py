"""Planted scenes before a real daemon, and what stays of them in its answers and its memory."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.keys.clear_part import clear_part_gain, columns, differences
from benchmarks.privacy.keys.options import (
    BundleOption,
    EpochsOption,
    SeedOption,
    WorkArgument,
    shown_progress,
)
from benchmarks.privacy.keys.past import take_past
from benchmarks.privacy.keys.plant import (
    Picture,
    fresh_daemon,
    planted,
    read_answers,
    two_scenes,
)
from benchmarks.rig import work_folder

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_server.demo_data import FRESH, load_digits
from veilcam_training.attacks.intervals import area


def answers(
    work: WorkArgument,
    *,
    count: Annotated[int, typer.Option(min=20, help="Captures of each of two scenes.")] = 2000,
    bundle: BundleOption = FRESH,
    epochs: EpochsOption = 8,
    seed: SeedOption = 1,
    figures: FiguresOption = None,
) -> None:
    """Plant a digit and an empty room before a real daemon; tell them apart by its answers."""
    labels = two_scenes(count, seed)
    digit = load_digits().images[0]
    # Not black: a camera that sees nothing at all says that it is too dark.
    empty = np.full_like(digit, 64)
    pictures = [digit if each else empty for each in labels]
    path = work / f"two-sealed-{count}-{seed}.jsonl"
    _plant(path, bundle, pictures, labels)
    found, planted_labels = read_answers(path), np.array(labels)
    made = columns(found)
    told = differences(made, planted_labels)
    gain = clear_part_gain(made, planted_labels, epochs=epochs, seed=seed)
    print(f"{len(found)} answers, {len(made)} columns differ from answer to answer")
    print(f"columns of which the distributions differ: {', '.join(told) or 'none'}")
    print(f"clear part: AUC {gain.shown:.4f}, standard error {gain.error:.4f}, n = {gain.count}")
    waits = np.array([each.waited for each in found])
    wait, error = area(waits, planted_labels == 1)
    print(f"no part of an answer: how long it took, AUC {wait:.4f}, standard error {error:.4f}")
    values = {
        "clear_part_auc": round(gain.shown, 4),
        "clear_part_auc_error": round(gain.error, 4),
        "clear_part_differences": len(told),
        "answer_time_auc": round(wait, 4),
    }
    record(figures, values)


def _plant(path: Path, bundle: Path, pictures: list[Picture], labels: list[int]) -> None:
    receiver = ReceiverKey.generate().public
    done = len(read_answers(path)) if path.exists() else 0
    if done == len(labels):
        return
    with (
        work_folder() as folder,
        fresh_daemon(bundle, folder, receiver) as daemon,
        shown_progress() as progress,
    ):
        task = progress.add_task("answers", total=len(labels), completed=done)
        for number in planted(daemon, pictures, labels, path):
            progress.update(task, completed=number)


def past(
    *,
    captures: Annotated[int, typer.Option(min=1, help="Each behind a mask of its own.")] = 1000,
    step: Annotated[int, typer.Option(min=1, help="Bytes from one guess at a key on.")] = 1,
    bundle: BundleOption = FRESH,
    figures: FiguresOption = None,
) -> None:
    """Take a daemon with its memory and files, and open what it sealed before."""
    with work_folder() as folder, shown_progress() as progress:
        task = progress.add_task("daemon", total=None)
        findings, size = take_past(
            bundle,
            folder,
            captures,
            step=step,
            told=lambda what: progress.update(task, description=what),
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
