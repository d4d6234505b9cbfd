"""Shows held-out digits to a daemon, through the SDK, while its masks change."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from veilcam_client import Camera, Classification, EveryCaptures
from veilcam_server.demo.daemon import running
from veilcam_server.demo.observer import KeyObserver, Observer, PairObserver
from veilcam_server.demo.report import Row, write_report
from veilcam_server.demo.tally import Sample, Tally
from veilcam_server.demo_data import BUNDLE, DIGITS, FRESH, Digits, load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.errors import StartError
from veilcam_server.masks.secret import find_secret, write_secret
from veilcam_training.bundle import Bundle, BundleError, read_bundle

REPORT_ROWS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What to demonstrate."""

    fresh: bool = False
    """Draw every mask from a key, and refuse a bundle of pairs."""
    bundle: Path | None = None
    """Instead of the one that comes along."""
    digits: Path = DIGITS
    out: Path = Path("demo")
    captures: int = 200
    every: int | None = None
    """Captures under one mask; by default 10, and 1 if ``fresh``."""
    seed: int = 0
    """Chooses the digits."""
    wrong_classifier: bool = False

    @property
    def path(self) -> Path:
        """File of the bundle."""
        return self.bundle or (FRESH if self.fresh else BUNDLE)

    @property
    def captures_per_mask(self) -> int:
        """How many are taken under one mask."""
        return self.every or (1 if self.fresh else 10)


def demonstrate(plan: Plan, console: Console) -> Tally:
    """Run the demonstration and write ``report.png``; returns what was counted.

    Raises:
        StartError: a file is missing or bad, or the daemon did not start.
        VeilcamError: the daemon failed on the way.
    """
    try:
        bundle = read_bundle(plan.path)
    except BundleError as error:
        raise StartError(str(error)) from None
    if plan.fresh and bundle.mode != "fresh":
        raise StartError(f"--fresh: {plan.path} holds pairs: give a bundle of mode 'fresh'")
    digits = load_digits(plan.digits)
    if digits.images.shape[1:] != bundle.scene.shape:
        raise StartError(f"{plan.digits} holds images of another size than {plan.path}")
    if plan.captures > len(digits):
        raise StartError(f"--captures {plan.captures}: {plan.digits} holds {len(digits)} digits")
    plan.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="veilcam-demo-") as temporary:
        directory = Path(temporary)
        scene = directory / "scene.npy"
        write_scene(scene, np.zeros(bundle.scene.shape, np.uint8))
        options, observer = _mode(bundle, directory)
        if plan.wrong_classifier:
            options = (*options, "--wrong-classifier")
        with running(plan.path, scene, directory, *options) as url:
            console.print(f"daemon    {url}, simulated camera in a process of its own")
            with Camera(url) as camera:
                tally, rows = _classify(
                    plan, bundle, digits, observer, scene=scene, camera=camera, console=console
                )
    console.print(tally.table())
    report = plan.out / "report.png"
    write_report(report, rows, bundle.camera, *_titles(bundle, tally, plan))
    console.print(f"report    {report}")
    return tally


def _mode(bundle: Bundle, directory: Path) -> tuple[tuple[str, ...], Observer]:
    """Return options for the daemon, and who knows its masks."""
    if bundle.mode == "pairs":
        # Pairs are told apart by what was read behind them.
        return ("--release", "raw"), PairObserver(bundle)
    secret = directory / "mask-secret"
    write_secret(secret)
    return ("--mask-secret", str(secret)), KeyObserver(bundle, find_secret(secret))


def _classify(
    plan: Plan,
    bundle: Bundle,
    digits: Digits,
    observer: Observer,
    *,
    scene: Path,
    camera: Camera,
    console: Console,
) -> tuple[Tally, list[Row]]:
    status = camera.status()
    rows, columns = status.bundle.embedding_shape
    console.print(
        f"task      {status.bundle.task}, {rows} x {columns} embeddings, "
        f"{status.bundle.pairs or 'fresh'} masks, a new one every {plan.captures_per_mask} captures"
    )
    if status.experiment:
        console.print(f"[yellow]experiment {status.experiment}: labels mean nothing[/yellow]")
    camera.set_rotation(EveryCaptures(captures=plan.captures_per_mask))
    tally, report = Tally(), dict[int, Row]()
    order = np.random.default_rng(plan.seed).choice(len(digits), plan.captures, replace=False)
    masks: dict[str, int] = {}
    with _progress(console) as progress:
        task = progress.add_task("classifying", total=plan.captures, accuracy="")
        for index in order:
            image, truth = digits.images[index], bundle.labels[int(digits.labels[index])]
            write_scene(scene, image)
            begun = time.perf_counter()
            answer = camera.classify(include_embedding=True)
            elapsed = time.perf_counter() - begun
            if answer.embedding is None:
                raise StartError("the daemon left the embedding out: update it")
            embedding = np.asarray(answer.embedding)
            if answer.epoch not in masks:
                masks[answer.epoch] = observer.which(image, embedding, answer.epoch)
            mask = masks[answer.epoch]
            tally.samples.append(_sample(answer, mask, truth, elapsed))
            if mask not in report and len(report) < REPORT_ROWS:
                report[mask] = Row(
                    image, observer.levels(mask), embedding, dict(answer.scores), truth
                )
            progress.update(task, advance=1, accuracy=f"accuracy {tally.accuracy:.3f}")
    return tally, list(report.values())


def _sample(answer: Classification, mask: int, truth: str, elapsed: float) -> Sample:
    return Sample(
        epoch=answer.epoch,
        mask=mask,
        right=answer.label == truth,
        settle=answer.timing.settle_s,
        capture=answer.timing.capture_s,
        inference=answer.timing.inference_s or 0.0,
        http=elapsed - answer.timing.total_s,
    )


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[accuracy]}"),
        TimeRemainingColumn(),
        console=console,
    )


def _titles(bundle: Bundle, tally: Tally, plan: Plan) -> tuple[str, str]:
    rows, columns = bundle.embedding.shape
    caption = (
        f"{len(tally.samples)} handwritten digits never trained on, {tally.masks} masks, "
        f"{rows} x {columns} measurements without a lens: {100 * tally.accuracy:.1f} % right"
    )
    if plan.wrong_classifier:
        caption += ", read as if another mask had been shown"
    return "What the camera sees, and what it says", caption
