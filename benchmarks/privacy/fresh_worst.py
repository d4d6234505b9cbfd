"""The most that anyone without a key gains on captures of fresh masks, one capture a mask.

``python -m benchmarks.privacy.fresh_worst --data data/mnist --faces data/faces
--work runs/fresh-worst --figures benchmarks/results/privacy.json``

What leaves ``white`` and what leaves ``sealed`` of thousands of masks is attacked on every question
by every family of attackers that has no key (:mod:`veilcam_training.attacks.keyless`). All rows
share one error of 1 % (Holm's procedure). The figure is in bars, of one point or of 0.02 of an area
under a curve: every row is shown to be within its bar where it is at most 1.

How many masks that takes: a share near one in ten has a standard error of 30 points over the root
of the captures, and thirty rows need an upper end 3.4 errors above what is found, which itself may
be 2 errors from nothing: 0.185 points, 26,000 captures. A small embedding is cheap to draw, and
tells no less of a rotation or a cipher than a large one.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.keys.options import EpochsOption, SeedOption, fresh_bundle, shown_progress
from benchmarks.privacy.keys.released import CAPTURES, CHUNK, chunk_path, write_chunk
from benchmarks.privacy.keys.rows import KINDS
from benchmarks.privacy.keys.scenes import Question, Scene, Scenes, load_scenes
from benchmarks.privacy.keys.white import tell

from veilcam_optics.camera.geometry import Embedding
from veilcam_optics.decoding import SceneDecoding
from veilcam_optics.files import write_whole
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach
from veilcam_server.demo_data import FRESH
from veilcam_training.attacks.intervals import Gain, holm
from veilcam_training.attacks.keyless import Asked, gain, worst_upper
from veilcam_training.attacks.networks import FAMILIES
from veilcam_training.attacks.victim import FORMS, FreshMasks, Victim
from veilcam_training.bundle import Bundle
from veilcam_training.seeding import derive, stream

FORM_NAMES = ("white", "sealed")
COUNTS: dict[Question, int] = {**CAPTURES, "presence": 2}
"""Captures of one mask to guess at: of two answers, two."""

app = typer.Typer(pretty_exceptions_enable=False)


class Collector:
    """Draws masks and keeps what leaves of each in all forms.

    Args:
        bundle: of mode fresh.
        embedding: of what leaves.
        scenes: to draw from.
        seed: of all that is drawn.
    """

    def __init__(self, bundle: Bundle, embedding: Embedding, scenes: Scenes, seed: int) -> None:
        if bundle.fresh is None:
            raise typer.BadParameter("use a bundle of mode fresh")
        self._scenes, self._seed = scenes, seed
        self._source = FreshMasks(bundle.camera, bundle.fresh.distribution)
        operators = [
            TransferOperator(bundle.camera, bundle.scene, embedding, reach=reach)
            for reach in (Reach(6, 1), Reach())
        ]
        self._light = operators[0]
        statistics = bundle.fresh.statistics.in_torch()
        self._decoding = SceneDecoding(operators[1], statistics, bundle.fresh.noise)

    def chunk(self, number: int) -> dict[str, npt.NDArray[np.generic]]:
        """What leaves of ``CHUNK`` masks: ``FORM QUESTION`` and ``label QUESTION``.

        Each mask answers each question with scenes of that question's own, as if it saw no others.
        """
        random = np.random.default_rng(derive(self._seed, "scenes", number))
        victim = Victim(
            self._light,
            self._source,
            FORMS["raw"],
            decoding=self._decoding,
            generator=stream(self._seed, "masks", number),
        )
        made: dict[str, list[npt.NDArray[np.generic]]] = {}
        twin: Scene | None = None
        for place in range(CHUNK):
            drawn = {
                question: [self._scenes.draw(question, random) for _ in range(COUNTS[question])]
                for question in self._scenes.classes
            }
            # Neighbours show the same scene.
            if place % 2 and twin is not None:
                drawn["linkage"] = [(twin, 0)]
            twin = drawn["linkage"][0][0]
            shown = [scene for each in drawn.values() for scene, _ in each]
            mask = victim.mask()
            measured = victim.measure(mask, torch.from_numpy(np.stack(shown)))
            counts = [len(each) for each in drawn.values()]
            for form in FORM_NAMES:
                left = np.split(FORMS[form](mask, measured).numpy(), np.cumsum(counts)[:-1])
                for question, vectors in zip(drawn, left, strict=True):
                    made.setdefault(f"{form} {question}", []).append(vectors)
            for question, each in drawn.items():
                answers = np.array([label for _, label in each])
                made.setdefault(f"label {question}", []).append(answers)
        return {name: np.stack(parts) for name, parts in made.items()}


def load(work: Path, form: str, question: Question, chunks: int) -> tuple[torch.Tensor, ...]:
    """Vectors (masks, captures, numbers) and labels (masks, captures) of the first chunks."""
    parts: list[list[npt.NDArray[np.generic]]] = [[], []]
    for number in range(chunks):
        with np.load(chunk_path(work, number), allow_pickle=False) as chunk:
            parts[0].append(chunk[f"{form} {question}"])
            parts[1].append(chunk[f"label {question}"])
    vectors, labels = (np.concatenate(each) for each in parts)
    return torch.from_numpy(vectors.astype(np.float32)), torch.from_numpy(labels.astype(np.int64))


@app.command()
def measure(
    *,
    data: Annotated[Path, typer.Option(help="Folder of MNIST's files.")],
    faces: Annotated[Path | None, typer.Option(help="Folder that holds faces.npz.")] = None,
    work: Annotated[Path, typer.Option(help="Folder of what was measured: resumes it.")],
    masks: Annotated[int, typer.Option(min=CHUNK, help="Each of one use.")] = 30_000,
    rows: Annotated[int, typer.Option(min=1, help="Of an embedding.")] = 3,
    columns: Annotated[int, typer.Option(min=1, help="Of an embedding.")] = 4,
    epochs: EpochsOption = 8,
    seed: SeedOption = 1,
    figures: FiguresOption = None,
) -> None:
    """Collect captures, attack them on every question, and say the worst upper end."""
    bundle, embedding = fresh_bundle(FRESH), Embedding(rows, columns)
    scenes = load_scenes(bundle.scene.shape, data, faces)
    work.mkdir(parents=True, exist_ok=True)
    collector, chunks = Collector(bundle, embedding, scenes, seed), -(-masks // CHUNK)
    names = [
        (form, question, family)
        for form in FORM_NAMES
        for question in scenes.classes
        for family in FAMILIES
    ]
    gains: dict[str, Gain] = {}
    with shown_progress() as progress:
        task = progress.add_task("chunks and rows", total=chunks + len(names))
        for number in range(chunks):
            path = chunk_path(work, number)
            if not path.exists():
                write_chunk(path, collector.chunk(number))
            progress.advance(task)
        for form, question, family in names:
            name = f"{form} {question} by {family}"
            kept = work / f"{name}, {CHUNK * chunks} masks, {epochs} epochs.json"
            if not kept.exists():
                vectors, labels = load(work, form, question, chunks)
                asked = Asked(
                    KINDS.get(question, "class"),
                    vectors,
                    labels,
                    scenes.classes[question],
                    embedding.shape if form == "white" else None,
                )
                found = gain(asked, family, epochs=epochs, seed=seed)
                write_whole(kept, json.dumps(asdict(found)).encode())
            gains[name] = Gain(**json.loads(kept.read_text()))
            progress.advance(task)
    verdicts = holm(gains)
    tell(verdicts)
    worst = worst_upper(verdicts)
    print(f"worst upper end: {worst:.3f} of its bar, {CHUNK * chunks} masks of {rows} x {columns}")
    record(
        figures,
        {
            "fresh_worst_advantage_upper": round(worst, 3),
            "fresh_worst_masks": CHUNK * chunks,
            "fresh_worst_rows": len(gains),
        },
    )


if __name__ == "__main__":
    torch.set_num_threads(1)
    app()
