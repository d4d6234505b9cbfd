"""Chart of digits read with the key against digits read without it, by optics and size.

    python -m benchmarks.privacy.hiding_chart --data data/mnist --work runs/hiding_chart
        --figures benchmarks/results/hiding.json --picture docs/images/hiding.png

The attacker is the better of two readers: trained behind masks of many kinds, and behind other
masks of the very kind. A lens and a pinhole have no key: whoever knows them reads, and sees, as
their owner does. What is done stands in ``--work``, a file for each point, and is not done again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, cast
from unittest.mock import patch

import numpy as np
import numpy.typing as npt
import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.paper.stopwatch import EpochLines
from benchmarks.paper.style import tidy
from benchmarks.privacy.hiding import SIZES
from matplotlib.figure import Figure

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.camera.masks import to_weights
from veilcam_training.config.files import load_settings
from veilcam_training.config.settings import parse_embedding
from veilcam_training.data import Source, open_source
from veilcam_training.encoders import ENCODERS, Encoder, FixedEncoder, LearnedMask, Mask, Setup
from veilcam_training.encoders.fresh import FreshCamera
from veilcam_training.encoders.imperfections import make_operators
from veilcam_training.experiments.fit import ATTEMPTS, run_fit, run_fresh
from veilcam_training.experiments.model import make_model, prepare
from veilcam_training.hiding.eye import drawn_eye
from veilcam_training.hiding.masks import Draw
from veilcam_training.hiding.pinholes import Measurer, pinhole
from veilcam_training.hiding.reader import Reader, scenes_of
from veilcam_training.hiding.scenes import GROUP, noisy

Values = npt.NDArray[Any]

KINDS = {
    "learned": ("learned", "learned mask", "*"),
    "random": ("fixed_simulated", "random mask", "s"),
    "fresh": ("", "fresh masks", "D"),
    "lens": ("lens", "lens", "o"),
    "pinhole": ("pinhole", "pinhole", "^"),
}
"""Encoder, name and marker."""
CHANCE = 10
OTHERS = 12
"""Learned masks of other seeds that a reader is trained behind."""
FRESH = 20
"""Fresh masks that are looked at and read."""
SEED = 1


class Bench:
    """All that the points of one size share."""

    def __init__(self, source: Source, size: str, epochs: int) -> None:
        self.source, self.size, self.camera = source, size, Camera()
        embedding = parse_embedding(size)
        self.training, self.test = source.training(), source.test()
        self.asked = {"embedding": size, "classifier": "Scene8", "seed": SEED, "epochs": epochs}
        self.measure = Measurer(self.camera, source.scene, embedding, 1)
        self.scenes = scenes_of(self.test, slice(None))
        self.eye = drawn_eye(self.camera, source.scene, embedding, 1)
        setting = (self.camera, embedding, self.measure, self.training, len(source.labels))
        self.reader = partial(Reader, *setting)
        self.any = self.reader()

    def point(self, kind: str) -> dict[str, float]:
        """Percent read with the key and without it, and seen."""
        if kind == "fresh":
            fresh = load_settings(None, self.asked | {"fresh": {}})
            found = run_fresh(fresh, self.source, self.camera, callbacks=[EpochLines(kind)])
            key, read, seen = found.accuracy.value, *self._fresh(found.camera)
        else:
            settings = load_settings(None, self.asked | {"encoder": KINDS[kind][0]})
            with patch.dict(ENCODERS, {"pinhole": open_pinhole}):
                fitted = run_fit(settings, self.source, self.camera, callbacks=[EpochLines(kind)])
            key = fitted.accuracy.value
            read, seen = self._attacked(fitted.fit.model.encoder, key)
        values = {"key": key, "keyless": read, "seen": seen}
        return {name: round(100 * float(value), 2) for name, value in values.items()}

    def _attacked(self, encoder: Encoder, key: float) -> tuple[float, float]:
        if isinstance(encoder, FixedEncoder):
            transfer = encoder.transfer().numpy()
            shown = noisy(self.scenes.reshape(len(self.scenes), -1) @ transfer)
            read = max(key, self.any.read(shown, self.test.labels))
            return read, told_apart(self.eye.scenes, transfer)
        masks = [to_weights(cast(Mask, encoder).levels(), self.camera.panel)]
        if not isinstance(encoder, LearnedMask):
            return self._judged(masks, lambda shape, random: random.random(shape, np.float32))
        others = [self._other(seed, encoder) for seed in range(SEED + 1, SEED + 1 + OTHERS)]
        return self._judged(masks, lambda _, random: others[random.integers(OTHERS)])

    def _fresh(self, camera: FreshCamera) -> tuple[float, float]:
        def drawn(purpose: str, number: int) -> Values:
            return to_weights(camera.draw_levels(purpose, number), self.camera.panel)

        masks = [drawn("attacked", number) for number in range(FRESH)]
        # The distribution is public.
        return self._judged(masks, lambda _, random: drawn("own", int(random.integers(2**62))))

    def _other(self, seed: int, fitted: LearnedMask) -> Values:
        """Mask that an attacker learns in the same way."""
        settings = load_settings(None, self.asked | {"seed": seed})
        model = make_model(settings, self.source, self.camera)
        mask = cast(LearnedMask, model.encoder)
        mask.hide(ATTEMPTS[0][0] if fitted.hidden else 0)
        prepare(model, settings, self.training)
        return to_weights(mask.levels(), self.camera.panel)

    def _judged(self, masks: list[Values], draw: Draw) -> tuple[float, float]:
        """Shares that the better of two readers reads, and that an eye sees."""
        shown, labels = [self.measure(self.scenes, mask) for mask in masks], self.test.labels
        readers = (self.any, self.reader(draw=draw))
        read = max(np.mean([reader.read(each, labels) for each in shown]) for reader in readers)
        return float(read), float(np.mean([self.eye.seen(mask) for mask in masks]))


def open_pinhole(setup: Setup, *_: object) -> FixedEncoder:
    """Camera of one open sub-pixel of each colour."""
    (operator,) = make_operators(setup)
    weights = torch.from_numpy(pinhole(setup.camera))
    return FixedEncoder(setup, [operator(weights).to(weights.dtype)])


def told_apart(scenes: Values, transfer: Values) -> float:
    """Share of scenes picked out of a hundred by whoever knows the optics."""
    pictures = (scenes.reshape(len(scenes), -1) @ transfer).reshape(-1, GROUP, transfer.shape[1])
    found = [np.corrcoef(noisy(each), each)[:GROUP, GROUP:].argmax(1) for each in pictures]
    return float(np.mean(np.array(found) == np.arange(GROUP)))


def draw_chart(values: Mapping[str, float], picture: Path) -> None:
    """Draw points by the names that they are recorded under."""
    figure = Figure(figsize=(8, 6.2), layout="constrained")
    axes = figure.add_subplot()
    ends = (0, 103)
    axes.plot(ends, ends, color="#bbbbbb", linewidth=1, zorder=1)
    for line in (axes.axhline, axes.axvline):
        line(CHANCE, color="#777777", linestyle="--", linewidth=1, zorder=1)
    for kind, (_, name, marker) in KINDS.items():
        key, keyless, seen = (
            [values[f"chart_{kind}_{size}_{figure}"] for size in SIZES]
            for figure in ("key", "keyless", "seen")
        )
        axes.plot(keyless, key, color="#aaaaaa", linewidth=0.8, zorder=2)
        points = axes.scatter(
            *(keyless, key, [150, 90, 50, 25]), c=seen, marker=marker, cmap="viridis_r",
            vmin=0, vmax=100, edgecolors="#333333", linewidths=0.6, zorder=3,
        )  # fmt: skip
        axes.scatter([], [], s=70, marker=marker, color="#555555", label=name)
    axes.set(xlim=ends, ylim=ends, aspect="equal")
    axes.set_xlabel("read by a machine without the key [%]")
    axes.set_ylabel("read with the key [%]")
    axes.text(101, CHANCE + 1, "a guess", horizontalalignment="right", color="#555555")
    axes.text(75, 72, "a key adds nothing", rotation=45, color="#555555")
    title = "larger mark: larger size\n" + ", ".join(SIZES)
    axes.legend(title=title, loc="lower right", bbox_to_anchor=(1, 0.14), frameon=False)
    figure.colorbar(points, label="seen: picked out of 100 by an eye [%]")
    tidy(axes)
    figure.savefig(picture, dpi=130, facecolor="white")


def main(
    *,
    data: Annotated[Path, typer.Option(help="Folder with MNIST.")],
    work: Annotated[Path, typer.Option(help="Folder for a file of each point.")],
    picture: Annotated[Path, typer.Option(help="Chart to write.")],
    epochs: Annotated[int, typer.Option(min=1, help="Epochs of each fit.")] = 1,
    figures: FiguresOption = None,
) -> None:
    """Fit and attack all points that are not done; draw and record them."""
    torch.set_num_threads(1)
    work.mkdir(parents=True, exist_ok=True)
    source = open_source("mnist", data)
    values: dict[str, float] = {}
    for size in reversed(SIZES):
        bench: Bench | None = None
        for kind in KINDS:
            done = work / f"{kind}_{size}.json"
            if not done.exists():
                bench = bench or Bench(source, size, epochs)
                done.write_text(json.dumps(bench.point(kind)))
            point = json.loads(done.read_text())
            print(f"{kind} {size}: {point}", flush=True)
            values |= {f"chart_{kind}_{size}_{name}": value for name, value in point.items()}
    draw_chart(values, picture)
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
