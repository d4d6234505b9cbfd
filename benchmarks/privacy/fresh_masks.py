"""What fresh masks cost and what they keep: accuracy, time, release forms. One command a figure.

``python -m benchmarks.privacy.fresh_masks accuracy mnist_24x32 --data data/mnist
--work runs/mnist_24x32 --figures benchmarks/results/fresh-masks.json``
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.paper.stopwatch import EpochLines
from rich.console import Console
from torch import Tensor

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.camera.masks import quantise, random_mask, to_weights
from veilcam_optics.decoding import Precision, SceneDecoding
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach
from veilcam_training.attacks.clustering import adjusted_rand_index, k_means, subspace_clusters
from veilcam_training.attacks.keyless import KeylessCamera
from veilcam_training.bundle import LayerRecord, classifier_inputs, read_bundle, write_bundle
from veilcam_training.bundle.layers import Conv2d, Linear, Residual
from veilcam_training.config.files import load_settings
from veilcam_training.data import Images, Split, open_source, split
from veilcam_training.errors import require
from veilcam_training.experiments.fit import run_fresh
from veilcam_training.experiments.keyring import as_fresh_bundle
from veilcam_training.experiments.model import fresh_statistics, make_fresh_camera, make_fresh_model
from veilcam_training.models.classifiers import SceneTask, make_layers
from veilcam_training.models.lensless import FreshClassifier
from veilcam_training.models.network import build_classifier
from veilcam_training.seeding import seeded
from veilcam_training.trainer.callbacks import FitProgress, make_progress
from veilcam_training.trainer.loop import fit

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False)

SIZES = ("24x32", "12x16", "6x8", "3x4")
TASKS: Mapping[str, Mapping[str, Any]] = {
    **{f"mnist_{size}": {"embedding": size, "fresh": {}} for size in SIZES},
    "mnist_shift": {"fresh": {"placement": "anywhere"}},
    "fashion_24x32": {"data": "fashion", "fresh": {}},
    "faces_gender_24x32": {"data": "faces-gender", "fresh": {}},
    "cifar10_27x36": {"data": "cifar10", "embedding": "27x36", "fresh": {}},
}
"""Changes of the settings of a fit."""
STILL = {"rotation": 0.0, "scale": 0.0, "crop": 0}
"""Of what is not a picture."""
Data = Annotated[Path, typer.Option(help="Folder that holds the data set's files.")]


@app.command()
def accuracy(
    task: Annotated[str, typer.Argument(help=f"One of {', '.join(TASKS)}.")],
    *,
    data: Data,
    work: Annotated[
        Path | None, typer.Option(help="Folder for a checkpoint: resumes what is in it.")
    ] = None,
    masks: Annotated[
        int | None, typer.Option(min=1, help="Masks to test on; 200 by default.")
    ] = None,
    figures: FiguresOption = None,
) -> None:
    """Fit one classifier for all masks and test it once, on masks that it has never seen."""
    require(task in TASKS, f"task {task!r} is unknown: use one of {', '.join(TASKS)}")
    camera = Camera()
    settings = load_settings(None, TASKS[task])
    source = open_source(settings.data, data)
    settings = load_settings(None, TASKS[task], colour=source.colour)
    with make_progress(Console()) as progress:
        result = run_fresh(
            settings,
            source,
            camera,
            masks=masks,
            work=work,
            callbacks=[FitProgress(progress, task), EpochLines(task)],
        )
    percent = 100 * result.accuracy.value
    print(
        f"{task}: test {percent:.2f} % on {result.masks} unseen masks, "
        f"{100 * result.wrong_key_accuracy:.2f} % decoded with another mask's key, "
        f"validation {100 * result.fit.best.validation_accuracy:.2f} %, "
        f"{result.camera.distribution.bits:.0f} bits a mask"
    )
    if work is not None:
        write_bundle(work / f"{task}.veilcam", as_fresh_bundle(result, source, camera))
    record(
        figures,
        {
            f"fresh_{task}": round(percent, 2),
            f"fresh_{task}_wrong_key": round(100 * result.wrong_key_accuracy, 2),
            f"fresh_{task}_mask_bits": round(result.camera.distribution.bits),
        },
    )


@app.command()
def timing(*, data: Data, rounds: int = 30, figures: FiguresOption = None) -> None:
    """Time one epoch's preparation, and decoding with classification of one capture, 24x32."""
    model, images = _model(data)
    fresh, classifier = model.encoder, model.eval().classifier
    weights = _masks(rounds)
    with torch.no_grad():
        prepare = _milliseconds(fresh.decoding.prepare, weights)
        decoder = fresh.decoding.prepare(weights[0])
        measurements = list(
            fresh.decoding.operator.embed(images.scenes(slice(0, rounds)), weights[0])
        )
        classify = _milliseconds(
            lambda measurement: classifier(classifier_inputs(decoder, measurement[None])),
            measurements,
        )
    macs = _multiplications(model.layers, fresh.frame.statistics.pixels)
    print(
        f"prepare {prepare:.1f} ms, decode and classify {classify:.2f} ms, {macs / 1e6:.1f} M MACs"
    )
    record(
        figures,
        {
            "prepare_ms": round(prepare, 2),
            "decode_classify_ms": round(classify, 3),
            "classifier_macs": macs,
        },
    )


@app.command()
def clusters(
    *, data: Data, masks: int = 10, captures: int = 200, figures: FiguresOption = None
) -> None:
    """Cluster raw embeddings without a key; chance has an adjusted Rand index of 0."""
    model, images = _model(data)
    fresh = model.encoder
    generator = torch.Generator().manual_seed(7)
    released: list[Tensor] = []
    for index in range(masks):
        weights = torch.from_numpy(
            to_weights(fresh.draw_levels("clusters", index), fresh.setup.camera.panel)
        )
        mask = fresh.prepare(weights, fresh.panels("clusters"), generator)
        part = slice(index * captures, (index + 1) * captures)
        measurements = shot_noise(mask.embed(images.scenes(part)), 40.0, generator)
        released.append(measurements.flatten(1))
    labels = torch.arange(masks).repeat_interleave(captures)
    points = torch.cat(released)
    unit = points / points.norm(dim=1, keepdim=True)
    indices = {
        "k-means": adjusted_rand_index(labels, k_means(points, masks, generator)),
        "k-means of directions": adjusted_rand_index(labels, k_means(unit, masks, generator)),
        "subspaces": adjusted_rand_index(labels, subspace_clusters(points, masks, generator)),
        "subspaces of squares": adjusted_rand_index(
            labels, subspace_clusters(points.square(), masks, generator)
        ),
    }
    print({name: round(value, 4) for name, value in indices.items()}, flush=True)
    record(figures, {"cluster_ari_raw": round(max(map(abs, indices.values())), 4)})


@app.command()
def keyless(
    *,
    data: Data,
    exponent: Annotated[float, typer.Option(help="Of the masks' distribution.")] = 1.0,
    epochs: int = 6,
    images: int = 20_000,
    figures: FiguresOption = None,
) -> None:
    """Classify raw embeddings without a key: what they do not hide. Chance is 10 %."""
    chosen = {"fresh": {"exponent": exponent}, "epochs": epochs, "jitter": STILL}
    settings = load_settings(None, chosen)
    source, camera = open_source(settings.data, data), Camera()
    parts = split(source.training())
    parts = Split(parts.training.take(torch.arange(images)), parts.validation)
    known = fresh_statistics(settings, camera, source.scene, parts.training)
    keyed = make_fresh_camera(settings, camera, source.scene, known)
    attacked = KeylessCamera(keyed)
    task = SceneTask(1, *attacked.setup.embedding.shape, 10)
    layers = make_layers(settings.classifier, task)
    with seeded(settings.seed, "classifier"):
        model = FreshClassifier(attacked, layers)
    result = fit(
        model,
        parts,
        settings,
        callbacks=[EpochLines("raw")],
    )
    percent = 100 * result.best.validation_accuracy
    print(f"exponent {exponent:g}: {percent:.2f} % of validation images, unseen masks")
    name = "keyless_accuracy_raw" + ("" if exponent == 1 else f"_exponent{exponent:g}")
    record(figures, {name: round(percent, 2)})


@app.command()
def dials(
    bundle: Annotated[Path, typer.Argument(help="Bundle of mode fresh, 24x32.")],
    *,
    data: Data,
    picture: Annotated[Path, typer.Option(help="Chart to write, .png or .svg.")],
    images: int = 2000,
    masks: int = 40,
    figures: FiguresOption = None,
) -> None:
    """Chart errors against preparation time over rank, precision and interfering terms.

    The camera that reads has all the terms; on the validation images, behind masks never seen.
    """
    import matplotlib as mpl  # noqa: PLC0415 - the other commands do without

    mpl.use("Agg")
    import matplotlib.pyplot as plt  # noqa: PLC0415
    from matplotlib import ticker  # noqa: PLC0415

    contents = read_bundle(bundle)
    fresh = contents.fresh
    if fresh is None:
        raise typer.BadParameter("use a bundle of mode fresh")
    classifier, statistics = (
        build_classifier(fresh.layers, fresh.weights),
        fresh.statistics.in_torch(),
    )
    source = open_source(contents.task, data)
    shown = split(source.training()).validation.take(torch.arange(images))
    weights = _masks(masks)
    truth = TransferOperator(
        contents.camera, contents.scene, contents.embedding, reach=Reach(6, 1), dtype=torch.float64
    )
    random = torch.Generator().manual_seed(1)
    with torch.no_grad():
        measurements = [
            shot_noise(truth.embed(shown.scenes(part).double(), mask.double()), 40.0, random)
            for part, mask in zip(torch.arange(images).tensor_split(masks), weights, strict=True)
        ]
    figure, axes = plt.subplots(figsize=(7, 4.5))
    values: dict[str, float] = {}
    for name, precision, reach in (
        ("float32", Precision.SINGLE, Reach(0, 0)),
        ("mixed", Precision.MIXED, Reach(0, 0)),
        ("mixed, interference of 3 rows", Precision.MIXED, Reach(3, 0)),
        ("mixed, interference of 3 rows and 1 column", Precision.MIXED, Reach(3, 1)),
        ("float64", Precision.DOUBLE, Reach(0, 0)),
    ):
        operator = TransferOperator(
            contents.camera,
            contents.scene,
            contents.embedding,
            reach=reach,
            dtype=getattr(torch, precision.products),
        )
        times, accuracies = [], []
        ranks = [rank for rank in (32, 64, 128, 256, 384) if rank <= statistics.rank]
        for rank in ranks:
            decoding = SceneDecoding(
                operator, statistics.truncate(rank), fresh.noise, precision=precision
            )
            with torch.no_grad():
                milliseconds = _milliseconds(decoding.prepare, weights[:15])
                logits = [
                    classifier(classifier_inputs(decoding.prepare(mask), part).float())
                    for mask, part in zip(weights, measurements, strict=True)
                ]
            accuracy = float((torch.cat(logits).argmax(1) == shown.labels).double().mean())
            print(f"{name} rank {rank}: {milliseconds:.1f} ms, {100 * accuracy:.2f} %", flush=True)
            times.append(milliseconds)
            accuracies.append(100 * accuracy)
            key = name.replace(",", "").replace(" ", "_")
            values[f"dial_{key}_rank{rank}_ms"] = round(milliseconds, 2)
            values[f"dial_{key}_rank{rank}_accuracy"] = round(100 * accuracy, 2)
        axes.plot(times, [100 - value for value in accuracies], "o-", label=name)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(ticker.FormatStrFormatter("%g"))
        axis.set_minor_locator(ticker.NullLocator())
    axes.grid(alpha=0.3)
    axes.set_xlabel("preparation of one mask [ms], one core")
    axes.set_ylabel("errors behind unseen masks [%]")
    axes.set_title("Dials of the decoder, 24 x 32; from left to right: rank 32, 64, 128, 256, 384")
    axes.legend()
    figure.tight_layout()
    figure.savefig(picture, dpi=120)
    record(figures, values)


def _model(data: Path) -> tuple[FreshClassifier, Images]:
    """The model of task mnist_24x32, not fitted, and validation images to show it."""
    settings, camera = load_settings(None, {"fresh": {}}), Camera()
    source = open_source(settings.data, data)
    images = split(source.training())
    known = fresh_statistics(settings, camera, source.scene, images.training)
    return make_fresh_model(settings, source, camera, known), images.validation


def _multiplications(layers: Sequence[LayerRecord], inputs: int) -> int:
    """Multiply-accumulate operations for one sample, in convolutions and linear layers."""
    total = 0
    shape: tuple[int, ...] = (inputs,)
    for layer in layers:
        after = layer.output_shape(shape)
        for each in layer.layers if isinstance(layer, Residual) else (layer,):
            if isinstance(each, Conv2d):
                total += math.prod(after) * each.inputs // each.groups * each.kernel**2
            elif isinstance(each, Linear):
                total += each.inputs * each.outputs
        shape = after
    return total


def _masks(count: int) -> list[Tensor]:
    generator = torch.Generator().manual_seed(0)
    camera = Camera()
    return [quantise(random_mask(camera, generator), camera.panel) for _ in range(count)]


def _milliseconds(run: Callable[[Tensor], object], arguments: list[Tensor]) -> float:
    """Median time of one call on one core; the first calls warm up.

    It is the time of the processor: whatever else keeps the machine busy does not count.
    """
    for argument in arguments[:3]:
        run(argument)
    seconds = []
    for argument in arguments:
        started = time.process_time()
        run(argument)
        seconds.append(time.process_time() - started)
    return 1e3 * statistics.median(seconds)


if __name__ == "__main__":
    torch.set_num_threads(1)
    app()
