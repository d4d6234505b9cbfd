"""What a camera that looks by itself believes: false sights, right labels, latency. Simulated.

``python -m benchmarks.people.belief measure --figures benchmarks/results/people.json``

Decoder, classifier, filter and thresholds are the daemon's own; what lies between them, HTTP and
the event loop, is left out. Every look is behind another one of several hundred fresh masks. Light
is computed with the matrix that the decoder inverts; ``grid`` compares that with the light by which
the daemon's simulated camera sees. ``fix`` shows what the numbers of the filter come from.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.people.looks import (
    Rig,
    Scenes,
    as_scenes,
    empty_scenes,
    fixing_digits,
    odd_scenes,
    unseen_digits,
)
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from veilcam_server.demo_data import Digits
from veilcam_server.masks.source import Evidence
from veilcam_server.watch.belief import FRESH, Dynamics, Sensing, Thresholds, fuse
from veilcam_server.watch.sightings import Fusion

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False)

FIXING, TESTING = 5, 6
"""Seeds: of what fixed the numbers of the filter, and of what is recorded."""
EMPTY_LOOKS, DIGIT_LOOKS = 25_000, 10_000
RATE = 2.0
"""Looks in a second."""
SHORTEST, LONGER = 1.5, 1.5
"""A digit is held up for so long, and longer by a time with this mean [s]."""
GAPS = (1.0, 5.0)
"""Shortest and longest time without one [s]."""

Data = Annotated[
    Path | None, typer.Option(help="Folder with the MNIST test files, for more digits.")
]


@dataclass(frozen=True, slots=True)
class Presentation:
    """One digit, held up for a while."""

    label: str
    begin: float
    """[s]"""
    looks: range
    """That see it."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a presentation."""

    right: bool
    """Whether its label alone was told of, and still held at its last look."""
    latency: float
    """From its beginning to when its label was told of; nan: it was not [s]."""


def timeline(
    digits: Digits, looks: int, rate: float, draw: np.random.Generator
) -> tuple[Scenes, list[Presentation]]:
    """Digits held up one after the other, with gaps, at random times, until so many looks saw one.

    Returns:
        What each look sees, and the presentations.
    """
    order = draw.permutation(len(digits))
    scenes, shown = list[Scenes](), list[Presentation]()
    now, seen = 0.0, 0
    while seen < looks:
        begin = now + draw.uniform(*GAPS)
        end = begin + SHORTEST + draw.exponential(LONGER)
        first, last = math.ceil(begin * rate), math.ceil(end * rate)
        scenes.append(empty_scenes(first - (shown[-1].looks.stop if shown else 0), draw))
        place = order[len(shown) % len(order)]
        image = as_scenes(digits.images[place])
        scenes.append(np.broadcast_to(image, (last - first, *image.shape)))
        shown.append(Presentation(str(digits.labels[place]), begin, range(first, last)))
        now, seen = end, seen + last - first
    return np.concatenate(scenes), shown


def follow(looks: Sequence[Evidence], rate: float) -> tuple[list[str | None], list[list[str]]]:
    """What is there after each look, and what was told of with it."""
    fusion = Fusion(Thresholds(), Dynamics(), 1)
    there, told = [], []
    for number, evidence in enumerate(looks):
        changes = fusion.take(evidence, number / rate)
        told.append([change.label for change in changes if change.kind == "seen"])
        last = next(iter(fusion.history), None)
        there.append(None if last is None or last.until is not None else last.label)
    return there, told


def outcomes(
    looks: Sequence[Evidence], shown: Sequence[Presentation], rate: float
) -> list[Outcome]:
    """What came of every presentation."""
    there, told = follow(looks, rate)
    found = []
    for each in shown:
        labels = [(number, label) for number in each.looks for label in told[number]]
        first = next((number for number, label in labels if label == each.label), None)
        found.append(
            Outcome(
                right=there[each.looks[-1]] == each.label and len(labels) == 1,
                latency=math.nan if first is None else first / rate - each.begin,
            )
        )
    return found


@app.command()
def measure(
    *,
    data: Data = None,
    count: Annotated[int, typer.Option(help="Looks at digits.")] = DIGIT_LOOKS,
    seed: int = TESTING,
    figures: FiguresOption = None,
) -> None:
    """Count false sights of empty scenes, and presentations whose label was right.

    No digit is among them that fixed a number of the filter, and none comes twice as long as there
    are others.
    """
    began, draw, rig = time.process_time(), np.random.default_rng(seed), Rig(seed)
    _, told = follow(rig.look(empty_scenes(EMPTY_LOOKS, draw)), RATE)
    false = sum(map(len, told))
    digits = unseen_digits(data)
    scenes, shown = timeline(digits, count, RATE, draw)
    looks = rig.look(scenes)
    found = outcomes(looks, shown, RATE)
    right = float(np.mean([each.right for each in found]))
    latency = [each.latency for each in found if not math.isnan(each.latency)]
    single = [
        [int(np.argmax(looks[number].logits)) == int(each.label) for number in each.looks]
        for each in shown
    ]
    alone = [right for each in single for right in each]
    lost = [not any(each) for each, what in zip(single, found, strict=True) if not what.right]
    low, high = _interval(sum(each.right for each in found), len(found))
    print(f"{EMPTY_LOOKS} looks at empty scenes: {false} false sights")
    print(
        f"{len(alone)} looks at {len(shown)} presentations of {len(digits)} digits: label right in "
        f"{100 * right:.2f} % ({100 * low:.2f} to {100 * high:.2f} %, 95 %), "
        f"{100 * np.mean(alone):.2f} % of single looks"
    )
    print(f"{len(lost)} were not right; {sum(lost)} of them are misread in every single look")
    print(
        f"latency at {RATE:g} looks a second: {np.median(latency):.2f} s in the median, "
        f"{np.percentile(latency, 95):.2f} s in 95 %; {time.process_time() - began:.0f} s of CPU"
    )
    record(
        figures,
        {
            "belief_false_seen": false,
            "belief_right_fraction": round(right, 5),
            "belief_latency_s": round(float(np.median(latency)), 3),
        },
    )


def _interval(successes: int, trials: int) -> tuple[float, float]:
    """Wilson's, 95 %."""
    z, share = 1.96, successes / trials
    centre = (share + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z * math.sqrt(share * (1 - share) / trials + (z / (2 * trials)) ** 2)
    half /= 1 + z * z / trials
    return centre - half, centre + half


@app.command()
def odd(*, count: int = 200, held: int = 8, seed: int = TESTING) -> None:
    """Say what comes out of scenes that are no digits, and of digits that are hard to see."""
    draw, rig = np.random.default_rng(seed), Rig(seed)
    digits = unseen_digits()
    chosen = draw.choice(len(digits), count, replace=False)
    labels = [str(label) for label in digits.labels[chosen]]
    print(f"{count} scenes each, {held} looks at every one: admitted looks, told, told rightly")
    for name, scenes in odd_scenes(digits.images[chosen], draw).items():
        looks = rig.look(np.repeat(scenes, held, axis=0))
        admitted = np.mean([Thresholds().admits(each) for each in looks])
        told = []
        for place, label in enumerate(labels):
            _, seen = follow(looks[place * held : (place + 1) * held], RATE)
            told.append([each == label for some in seen for each in some])
        some = np.mean([bool(each) for each in told])
        right = np.mean([each == [True] for each in told])
        print(f"  {name:34}  {100 * admitted:5.1f} %  {100 * some:5.1f} %  {100 * right:5.1f} %")


@app.command()
def grid(*, count: int = 120, masks: int = 12, seed: int = TESTING) -> None:
    """Compare looks by the matrix with those by the light of the daemon."""
    draw, rig = np.random.default_rng(seed), Rig(seed, masks)
    digits = unseen_digits()
    chosen = draw.choice(len(digits), count, replace=False)
    matrix, path = rig.look_by_grid(as_scenes(digits.images[chosen]), masks)
    same = np.mean(
        [np.argmax(a.logits) == np.argmax(b.logits) for a, b in zip(matrix, path, strict=True)]
    )
    novelty = [np.median([each.novelty for each in some]) for some in (matrix, path)]
    light = np.median([b.light / a.light for a, b in zip(matrix, path, strict=True)])
    print(
        f"{count} digits: the same label for {100 * same:.1f} %; light {light:.4f} times; novelty "
        f"{novelty[0]:.2f} by the matrix, {novelty[1]:.2f} by the daemon's light in the median, "
        f"{max(each.novelty or 0 for each in path):.2f} at most"
    )


@dataclass(frozen=True, eq=False)
class Repeated:
    """The same digits, looked at several times."""

    logits: npt.NDArray[np.float64]
    """(digits, looks, classes)."""
    labels: npt.NDArray[np.int64]

    def product(self, looks: int, temperature: float) -> npt.NDArray[np.float64]:
        """Scores of so many looks, multiplied as if they were independent, (digits, classes)."""
        scaled = self.logits[:, :looks] / temperature
        scaled = scaled - np.log(np.exp(scaled).sum(2, keepdims=True))
        return _normal(scaled.sum(1))

    def told(self, looks: int, sensing: Sensing) -> npt.NDArray[np.float64]:
        """What the filter tells after so many looks, after a gap, (digits, 1 + classes)."""
        dynamics, found = Dynamics(), []
        for logits in self.logits:
            belief = fuse(dynamics.prior(10), sensing.likelihood(logits[0], admitted=False))
            for each in logits[:looks]:
                ahead = dynamics.predict(belief, 1 / RATE)
                belief = fuse(ahead, sensing.likelihood(each, admitted=True))
            found.append(sensing.told(belief))
        return np.array(found)


def _normal(logs: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    scores = np.exp(logs - logs.max(1, keepdims=True))
    shares: npt.NDArray[np.float64] = scores / scores.sum(1, keepdims=True)
    return shares


def _loss(scores: npt.NDArray[np.float64], labels: npt.NDArray[np.int64]) -> float:
    """Mean negative logarithm of what is given to the right class."""
    return float(-np.log(np.maximum(scores[np.arange(len(labels)), labels], 1e-12)).mean())


def repeated(rig: Rig, digits: Digits, looks: int) -> Repeated:
    """Look at every digit so many times."""
    scenes = np.repeat(as_scenes(digits.images), looks, axis=0)
    logits = np.array([each.logits for each in rig.look(scenes)])
    return Repeated(logits.reshape(len(digits), looks, -1), digits.labels.astype(np.int64))


@app.command()
def fix(*, looks: int = 4, count: int = 1200, seed: int = FIXING) -> None:
    """Show what the numbers of the filter come from; digits and seed are those of nothing else."""
    draw, rig = np.random.default_rng(seed), Rig(seed)
    all_of_them = fixing_digits()
    chosen = draw.choice(len(all_of_them), min(count, len(all_of_them)), replace=False)
    digits = Digits(all_of_them.images[chosen], all_of_them.labels[chosen])
    scenes = as_scenes(digits.images)
    things, nothing = rig.look(scenes), rig.look(empty_scenes(len(scenes), draw))
    lit = [each for each in nothing if each.light >= Thresholds().least_light]
    for name, kind in (("digits", things), ("empty and lit", lit)):
        novelty = [each.novelty or 0 for each in kind]
        light = [each.light for each in kind]
        print(
            f"{name}: light {min(light):.4f} to {max(light):.4f}, "
            f"novelty {min(novelty):.2f} to {max(novelty):.2f}"
        )
    found = repeated(rig, digits, looks)
    temperatures = np.geomspace(0.3, 6, 40)
    for number in range(1, looks + 1):
        loss = [_loss(found.product(number, each), found.labels) for each in temperatures]
        right = 100 * np.mean(found.product(number, 1).argmax(1) == found.labels)
        honest = temperatures[np.argmin(loss)]
        print(f"{number} looks: {right:.2f} % right; their product is honest at T = {honest:.2f}")
    for temperature in (0.8, 1.0, 1.25, 1.5, 2.0):
        for misread in (0.001, 0.003, 0.01):
            sensing = Sensing(temperature=temperature, misread=misread)
            loss = [_loss(found.told(each, sensing)[:, 1:], found.labels) for each in (2, 3, 4)]
            print(f"temperature {temperature:g}, misread {misread:g}: loss {np.mean(loss):.4f}")


@app.command()
def chart(
    out: Annotated[Path, typer.Option(help="Picture to write.")] = Path("docs/images/belief.png"),
    *,
    count: int = 400,
    seed: int = TESTING,
) -> None:
    """Draw confidence, accuracy and latency against looks fused and time spent on one core."""
    draw, rig = np.random.default_rng(seed), Rig(seed)
    every = unseen_digits()
    chosen = draw.choice(len(every), count, replace=False)
    found = repeated(rig, Digits(every.images[chosen], every.labels[chosen]), 8)
    numbers = range(1, 9)
    told = [found.told(number, FRESH) for number in numbers]
    naive = [found.product(number, 0.55) for number in numbers]
    cost = _cost(rig, as_scenes(every.images[:1]))
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    shares = {
        "label right, where a thing is believed": [
            np.mean(each[:, 1:].argmax(1) == found.labels) for each in told
        ],
        "confidence that is told": [each.max(1).mean() for each in told],
        "confidence of a product, as if looks were independent": [
            each.max(1).mean() for each in naive
        ],
    }
    for (name, values), style in zip(shares.items(), ("o-", "s-", "^--"), strict=True):
        left.plot(numbers, 1 - np.array(values) + 1e-5, style, label=name)
    left.set(yscale="log", xlabel="looks fused", ylabel="1 - share")
    left.invert_yaxis()
    left.legend(fontsize=8)
    above = left.secondary_xaxis("top", functions=(lambda n: n * cost, lambda ms: ms / cost))
    above.set_xlabel("time spent on one core, masks included [ms]")
    for rate in (1.0, 2.0, 5.0):
        scenes, shown = timeline(every, 800, rate, draw)
        waits = [each.latency for each in outcomes(rig.look(scenes), shown, rate)]
        axis = np.linspace(0, 4, 400)
        share = [np.mean([wait <= at for wait in waits]) for at in axis]
        right.plot(axis, 100 * np.array(share), label=f"{rate:g} looks a second")
    right.set(xlabel="since it was held up [s]", ylabel="told rightly [%]", ylim=(0, 101))
    right.legend(fontsize=8)
    figure.savefig(out, dpi=110)
    print(f"{cost:.1f} ms a look on one core, its mask included; wrote {out}")


def _cost(rig: Rig, scene: Scenes, rounds: int = 20) -> float:
    """CPU time of one look: a mask, what reads behind it, one capture and the filter [ms]."""
    fusion = Fusion(Thresholds(), Dynamics(), 1)
    began = time.process_time()
    for number in range(rounds):
        mask = rig.draw()
        fusion.take(rig.look_behind(scene, mask)[0], number / RATE)
    return 1e3 * (time.process_time() - began) / rounds


if __name__ == "__main__":
    app()
