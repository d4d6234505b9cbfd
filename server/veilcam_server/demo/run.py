"""Shows held-out digits to a daemon, through the SDK, while its masks change."""

from __future__ import annotations

import base64
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from veilcam_client import Camera
from veilcam_client.keys.blocks import Opener
from veilcam_client.keys.commitments import logged_mask
from veilcam_client.keys.envelopes import open_key
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.models import EveryCaptures
from veilcam_client.wire.captures import Classification, SealedEmbedding
from veilcam_client.wire.sealing import Envelope
from veilcam_optics.keys.masks import draw_levels
from veilcam_server.demo.daemon import running
from veilcam_server.demo.report import Row, write_report
from veilcam_server.demo.tally import Sample, Tally
from veilcam_server.demo_data import BUNDLE, DIGITS, FRESH, Digits, load_digits
from veilcam_server.devices.base import Levels
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.errors import StartError
from veilcam_training.bundle import Bundle, BundleError, read_bundle

REPORT_ROWS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Settings of a demonstration."""

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
        """Number of captures under one mask."""
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
        write_scene(scene, digits.images[0])
        options = ("--wrong-classifier",) if plan.wrong_classifier else ()
        with running(plan.path, scene, directory, *options) as url:
            console.print(f"daemon    {url}, simulated camera in a process of its own")
            with Camera(url) as camera:
                show = _Show(plan, bundle, scene, camera, ReceiverKey.generate())
                tally, rows = show.classify(digits, console)
    console.print(tally.table())
    report = plan.out / "report.png"
    write_report(report, rows, bundle.camera, *_titles(bundle, tally, plan))
    console.print(f"report    {report}")
    return tally


class _Show:
    """Digits before one camera, seen by the receiver that it is paired with."""

    def __init__(
        self, plan: Plan, bundle: Bundle, scene: Path, camera: Camera, key: ReceiverKey
    ) -> None:
        self._plan, self._bundle, self._scene, self._camera = plan, bundle, scene, camera
        self._key, self._opener = key, Opener(key)
        self._masks: dict[str, tuple[int, Levels]] = {}

    def classify(self, digits: Digits, console: Console) -> tuple[Tally, list[Row]]:
        """Show digits, and return what was counted and what is drawn."""
        self._pair(console)
        plan, tally, report = self._plan, Tally(), dict[int, Row]()
        order = np.random.default_rng(plan.seed).choice(len(digits), plan.captures, replace=False)
        with _progress(console) as progress:
            task = progress.add_task("classifying", total=plan.captures, accuracy="")
            for index in order:
                truth = self._bundle.labels[int(digits.labels[index])]
                sample, row = self._one(digits.images[index], truth)
                tally.samples.append(sample)
                if sample.mask not in report and len(report) < REPORT_ROWS:
                    report[sample.mask] = row
                progress.update(task, advance=1, accuracy=f"accuracy {tally.accuracy:.3f}")
        return tally, list(report.values())

    def _pair(self, console: Console) -> None:
        """Have every embedding from now on sealed to our key, and say what serves."""
        camera, plan = self._camera, self._plan
        camera.receivers.add("demonstration", self._key.public)
        camera.rotation.set(EveryCaptures(captures=plan.captures_per_mask))
        # The mask that is shown was prepared before there was a receiver.
        camera.rotation.advance()
        status = camera.status()
        rows, columns = status.bundle.embedding_shape
        console.print(
            f"task      {status.bundle.task}, {rows} x {columns} embeddings, "
            f"{status.bundle.pairs or 'fresh'} masks, "
            f"a new one every {plan.captures_per_mask} captures"
        )
        console.print(
            f"receiver  {self._key.public.id[:16]}, made for this: it alone can open them"
        )
        if status.experiment:
            console.print(f"[yellow]experiment {status.experiment}: labels mean nothing[/yellow]")

    def _one(self, image: npt.NDArray[np.uint8], truth: str) -> tuple[Sample, Row]:
        write_scene(self._scene, image)
        begun = time.perf_counter()
        answer = self._camera.classify(include_embedding=True)
        elapsed = time.perf_counter() - begun
        sealed = answer.embedding
        if not isinstance(sealed, SealedEmbedding) or answer.scores is None:
            raise StartError("the daemon sealed no embedding, or told no scores: update it")
        opened = self._opener.open(answer)
        embedding = np.asarray(opened.embedding)
        if answer.epoch not in self._masks:
            self._masks[answer.epoch] = self._mask(sealed.envelope)
        mask, levels = self._masks[answer.epoch]
        sample = _sample(opened, mask, right=answer.label == truth, elapsed=elapsed)
        block = base64.b64decode(sealed.block)
        return sample, Row(image, levels, block, embedding, dict(answer.scores), truth)

    def _mask(self, envelope: Envelope) -> tuple[int, Levels]:
        """Return number and levels of the mask of the last capture, as every receiver can.

        A fresh mask is drawn again from the key of its epoch. A stored one is the mask of the
        bundle that the log commits to.
        """
        bundle, epoch = self._bundle, open_key(envelope, self._key, device=None)
        if bundle.fresh is not None:
            distribution = bundle.fresh.distribution
            levels = draw_levels(epoch.levels(), camera=bundle.camera, distribution=distribution)
            return len(self._masks), levels
        [record] = self._camera.log.list(limit=1, newest=True).records
        mask = logged_mask(record, epoch, [pair.levels for pair in bundle.pairs])
        if mask is None:
            raise StartError("the daemon's log commits to no mask of the bundle: update it")
        return mask, bundle.pairs[mask].levels


def _sample(opened: Classification, mask: int, *, right: bool, elapsed: float) -> Sample:
    if opened.notes is None:
        raise StartError("the daemon sealed no notes: update it")
    timing = opened.notes.timing
    device = timing.queue_s + timing.rotation_s + timing.settle_s + timing.capture_s
    return Sample(
        epoch=opened.epoch,
        mask=mask,
        right=right,
        settle=timing.settle_s,
        capture=timing.capture_s,
        rest=elapsed - device,
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
