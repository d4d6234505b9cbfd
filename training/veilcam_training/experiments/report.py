"""Report of a fit: its curve, confusion matrix and worst pictures, and a page with all of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from scipy.stats import binomtest
from torch import Tensor

from veilcam_optics.files import write_whole
from veilcam_training.data import Images
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.pages import embedded, page, png
from veilcam_training.trainer.callbacks import Epoch

WIDTH, DPI = 8.3, 144
"""Width of every picture [inches], and its pixels per inch."""
ACROSS, DOWN = 6, 4
"""Most pictures in a row of the worst ones, and most rows."""
NUMBERED = 12
"""Most classes of a confusion matrix with numbers in its cells."""
TICKS = 25
"""Most names along a side of a confusion matrix."""
SMALL, LONGEST = 8, 84
"""Size of small letters, and the greatest width of a name in them [points]."""
BLUE, ORANGE, RED, FAINT = "#1f6fb5", "#d98324", "#b3261e", "#5d656f"


@dataclass(frozen=True)
class Report:
    """Contents of a report.

    Attributes:
        title: name of the fit, e.g. ``photos, 27 x 36``.
        facts: rows of a small table, e.g. ``("classifier", "Scene32")``.
        sentences: sentences about what the masks hide.
        labels: names of the classes.
        history: epochs of the fit, in their order.
        images: test images.
        logits: classifier's outputs for the test images, float32 (count, classes).
        preparation: processor time before the first epoch [s]; the history's times include it.
    """

    title: str
    facts: Sequence[tuple[str, str]]
    sentences: Sequence[str]
    labels: Sequence[str]
    history: Sequence[Epoch]
    images: Images
    logits: Tensor
    preparation: float = 0.0


def write_report(folder: Path, report: Report) -> None:
    """Write ``accuracy.png``, ``confusion.png``, ``worst.png`` and ``report.html``.

    Args:
        folder: folder of the files; it is made if it is not there.
        report: contents; the pictures and names of the test images are shown as they are.

    Raises:
        TrainingError: the folder cannot be written to.
    """
    truth, logits = report.images.labels.cpu(), report.logits.cpu()
    counts = confusion(truth, logits)
    names = _drawable(report.labels)
    contents = {
        "accuracy.png": png(_draw_history(report.history, report.preparation), DPI),
        "confusion.png": png(_draw_confusion(counts, names), DPI),
        "worst.png": png(_draw_worst(report.images, logits, names), DPI),
    }
    right, total = int(counts.trace()), int(counts.sum())
    written = page(
        "report",
        report=report,
        right=right,
        total=total,
        percent=_percent,
        interval=binomtest(right, total).proportion_ci(0.95, "wilson"),
        figures=torch.stack((counts.diag(), counts.sum(1), counts.sum(0)), 1).tolist(),
        pictures={name.removesuffix(".png"): embedded(each) for name, each in contents.items()},
    )
    # A path among the facts may be of bytes that UTF-8 cannot hold.
    contents["report.html"] = written.encode(errors="backslashreplace")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            write_whole(folder / name, content)
    except OSError as error:
        raise TrainingError(f"{folder} cannot be written to ({error.strerror})") from None


def confusion(truth: Tensor, logits: Tensor) -> Tensor:
    """Count test images by true class (rows) and predicted class (columns).

    Args:
        truth: true labels, int64 (count,).
        logits: classifier's outputs, (count, classes).

    Returns:
        int64 (classes, classes).
    """
    classes = logits.shape[1]
    cells = truth * classes + logits.argmax(1)
    return torch.bincount(cells, minlength=classes**2).reshape(classes, classes)


def worst_first(truth: Tensor, logits: Tensor) -> Tensor:
    """Return the places of the images, int64 (count,): least probability of the true label first.

    Arguments are those of :func:`confusion`.
    """
    surprise = -logits.double().log_softmax(1).gather(1, truth[:, None])[:, 0]
    return surprise.argsort(descending=True, stable=True)


def _percent(part: float, whole: float = 1.0) -> str:
    """Return a share as it is read; a dash where there is nothing to have a share of."""
    return f"{100 * part / whole:.1f} %" if whole else "–"


def _drawable(labels: Sequence[str]) -> list[str]:
    """Names as the font can draw them, cut if long; one that lost something has its number."""
    font = get_font(findfont(FontProperties()))
    font.set_size(SMALL, 72)
    known = font.get_charmap()

    def width(text: str) -> float:
        font.set_text(text)
        return font.get_width_height()[0] / 64

    names = []
    for number, label in enumerate(labels):
        name = "".join(each if ord(each) in known else "□" for each in label)
        lead = "" if name == label else f"#{number} "
        if width(name) > LONGEST:
            lead = f"#{number} "
            while width(f"{lead}{name}…") > LONGEST:
                name = name[:-1].rstrip()
            name += "…"
        names.append(lead + name)
    return names


def _draw_history(history: Sequence[Epoch], preparation: float) -> Figure:
    """Accuracy of every epoch against the processor time at its end."""
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    axes = figure.subplots()
    seconds = np.array([epoch.processor_seconds for epoch in history])
    last = max((*seconds, preparation))
    unit, size = ("min", 60) if last > 180 else ("s", 1)
    if preparation:
        label = f"preparation ({preparation / size:.3g} {unit})"
        axes.axvspan(0, preparation / size, color="#e3e5e8", label=label)
    marker = "o" if len(history) <= 50 else ""
    for name, colour in (("training", ORANGE), ("validation", BLUE)):
        values = [100 * getattr(epoch, f"{name}_accuracy") for epoch in history]
        axes.plot(seconds / size, values, marker=marker, ms=3.5, color=colour, label=name)
    if history:
        chosen = max(history, key=lambda e: (e.validation_accuracy, -e.validation_loss))
        place = (chosen.processor_seconds / size, 100 * chosen.validation_accuracy)
        label = f"chosen: epoch {chosen.number + 1}, {place[1]:.1f} %"
        axes.plot(*place, "o", ms=11, mfc="none", mew=2, color=RED, label=label)
    low, high = axes.get_ylim()
    axes.set(ylim=(max(low, -2), min(high, 102)), ylabel="accuracy [%]")
    axes.set(xlim=(0, 1.03 * last / size or 1), xlabel=f"processor time [{unit}]")
    axes.grid(color="#e3e5e8", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=4, frameon=False, fontsize=9)
    return figure


def _draw_confusion(counts: Tensor, names: Sequence[str]) -> Figure:
    """Shares of each true class; numbers where there is room for them."""
    classes = len(names)
    shares = (100 * counts / counts.sum(1, keepdim=True).clamp(min=1)).numpy()
    figure = Figure(figsize=(WIDTH, min(2.6 + 0.5 * classes, 7.6)), layout="constrained")
    axes = figure.subplots()
    drawn = axes.imshow(shares, cmap="Blues", vmin=0, vmax=100)
    places = range(0, classes, -(-classes // TICKS))
    ticks = [names[each] for each in places]
    flat = max(map(len, ticks)) * classes <= 40
    axes.set_xticks(places, ticks, rotation=0 if flat else 90, fontsize=9, parse_math=False)
    axes.set_yticks(places, ticks, fontsize=9, parse_math=False)
    axes.set(xlabel="predicted", ylabel="true")
    if classes > NUMBERED:
        figure.colorbar(drawn, label="share of the true class [%]")
        return figure
    axes.set_title("percent of the true class (pictures)", fontsize=10, color=FAINT)
    for row, column in counts.nonzero().tolist():
        share, count = shares[row, column], int(counts[row, column])
        colour = "white" if share > 55 else "black"
        label = f"{share:.0f}\n({count})"
        axes.text(column, row, label, ha="center", va="center", color=colour, fontsize=SMALL)
    return figure


def _draw_worst(images: Images, logits: Tensor, names: Sequence[str]) -> Figure:
    """Test pictures whose true label has the least probability, the worst first."""
    places = worst_first(images.labels.cpu(), logits)[: ACROSS * DOWN]
    sure, predicted = logits[places].double().softmax(1).max(1)
    shown = images.take(places.to(images.labels.device)).to("cpu")
    scenes = shown.scenes().numpy()
    side, rows = WIDTH / ACROSS, -(-len(places) // ACROSS)
    # Narrow pictures are drawn smaller, so that rows are no higher than half as much again.
    height = side * min(scenes.shape[-2] / scenes.shape[-1], 1.5)
    pitch = height + 0.55
    figure = Figure(figsize=(WIDTH, rows * pitch))
    style: dict[str, Any] = {"ha": "center", "va": "top", "size": SMALL, "parse_math": False}
    for place, (scene, truth, guess, share) in enumerate(
        zip(scenes, shown.labels.tolist(), predicted.tolist(), sure.tolist(), strict=True)
    ):
        row, column = divmod(place, ACROSS)
        top = 1 - row / rows
        box = (column / ACROSS + 0.003, top - height / pitch / rows, 1 / ACROSS - 0.006)
        axes = figure.add_axes((*box, height / pitch / rows), anchor="N")
        axes.set_axis_off()
        picture = scene if scene.ndim == 2 else scene.transpose(1, 2, 0)
        axes.imshow(picture, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        # The mark before the arrow keeps it to the left of names that are written from the right.
        caption = f"{names[truth]}\n\u200e→ {names[guess]}\n{100 * share:.0f} %"
        colour = FAINT if truth == guess else RED
        axes.text(0.5, -0.04, caption, transform=axes.transAxes, color=colour, **style)
    return figure
