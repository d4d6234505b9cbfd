"""``veilcam-train fit``: one camera and classifier, and a folder with all that came of it."""

import os
import re
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from veilcam_optics.camera.geometry import Camera
from veilcam_training.bundle import Bundle, sentences, write_bundle
from veilcam_training.cli.bundle import light_line
from veilcam_training.cli.options import (
    AllowVisible,
    Batch,
    Binning,
    ChangeName,
    Classifier,
    Config,
    Dataset,
    Device,
    EncoderName,
    EndToEnd,
    Epochs,
    Folder,
    Logs,
    Psf,
    PsfDistance,
    PsfPitch,
    RecipeName,
    Seed,
    Shape,
    SkipDamaged,
    Threads,
    given,
    opened,
    prepare,
    show_summary,
)
from veilcam_training.config.files import load_settings
from veilcam_training.config.settings import FitSettings
from veilcam_training.data import Source, recognise
from veilcam_training.data.base import ReadOnce
from veilcam_training.encoders import read_psf
from veilcam_training.encoders.registry import WITH_PSF
from veilcam_training.errors import TrainingError, require
from veilcam_training.experiments.fit import FitResult, FreshResult, settle_seed
from veilcam_training.experiments.keyring import check_fit, fit_bundle
from veilcam_training.files import check_folder
from veilcam_training.trainer.callbacks import (
    Callback,
    CsvLog,
    FitProgress,
    TensorBoardLog,
    make_progress,
    minutes,
)

console = Console()
RUNS = Path("runs")
BUNDLE = "model.veilcam"
_UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0}


def fit_command(
    *,
    data: Folder,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for bundle, curves and report; runs/NAME by default."),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a fit that was broken off.")
    ] = False,
    budget: Annotated[
        str | None,
        typer.Option(help="Processor time of it all, e.g. 90s, 3m or 1h: chooses the epochs."),
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="For masks that nobody has used before.")
    ] = False,
    config: Config = None,
    dataset: Dataset = None,
    classifier: Classifier = None,
    encoder: EncoderName = None,
    psf: Psf = None,
    psf_pitch: PsfPitch = None,
    psf_distance: PsfDistance = None,
    embedding: Shape = None,
    binning: Binning = None,
    change: ChangeName = None,
    recipe: RecipeName = None,
    epochs: Epochs = None,
    batch: Batch = None,
    allow_visible: AllowVisible = False,
    end_to_end: EndToEnd = None,
    seed: Seed = None,
    tensorboard: Logs = None,
    skip_damaged: SkipDamaged = False,
    device: Device = "auto",
    threads: Threads = None,
) -> None:
    """Fit one camera and classifier, test them once, and leave a folder with a report."""
    chosen = given(
        data=dataset,
        classifier=classifier,
        encoder=encoder,
        psf=psf,
        psf_pitch=psf_pitch,
        psf_distance=psf_distance,
        embedding=embedding,
        binning=binning,
        change=change,
        recipe=recipe,
        epochs=epochs,
        batch=batch,
        hidden=False if allow_visible else None,
        end_to_end=end_to_end,
        fresh={} if fresh else None,
        seed=seed,
    )
    seconds = None if budget is None else parse_budget(budget)
    require(
        seconds is None or epochs is None,
        "--budget and --epochs are both given: a budget chooses the epochs, so use one of them",
    )
    place = prepare(device, threads)
    load = partial(load_settings, config, chosen, found=recognise(data))
    settings, source = opened(load, data, skip_damaged=skip_damaged)
    source, camera = ReadOnce(source), Camera()
    shown = Path(os.path.abspath(data)).name
    folder = run_folder(out, f"{shown}-{settings.embedding}", resume=resume)
    if tensorboard is not None:
        check_folder("--tensorboard", tensorboard)
    check_fit(settings, source, camera, budget=seconds)
    (folder / "work").mkdir(parents=True, exist_ok=True)
    settings = settle_seed(settings, folder / "work")
    show_summary(console, source)
    psf_used = settings.psf_file if settings.encoder in WITH_PSF else None
    if psf_used and (said := read_psf(psf_used, camera.distance).warning):
        console.print(f"warning: {said}", markup=False, highlight=False, soft_wrap=True)
    kind = settings.encoder if settings.fresh is None else "fresh"
    name = f"{settings.classifier} {kind} {settings.embedding}"
    with make_progress(console) as progress:
        callbacks: list[Callback] = [
            FitProgress(progress, name),
            CsvLog(folder / "history.csv"),
            *([] if tensorboard is None else [TensorBoardLog(tensorboard)]),
        ]
        result, bundle = fit_bundle(
            settings,
            source,
            camera,
            budget=None if seconds is None else seconds - time.process_time(),
            device=place,
            work=folder / "work",
            callbacks=callbacks,
        )
    if bundle is not None:
        write_bundle(folder / BUNDLE, bundle)
    hidden = () if bundle is None or bundle.hiding is None else sentences(bundle.hiding)
    _report(folder, f"{shown}: {name}", result, source, hidden)
    for line in (
        *_sentences(result, bundle),
        *hidden,
        f"wrote {folder}/report.html",
        _next(folder, bundle),
    ):
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def parse_budget(text: str) -> float:
    """Return the seconds of a text as ``90s``, ``3m`` or ``1.5h``.

    Raises:
        TrainingError: a text of another form, or no time at all.
    """
    match = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)([smh])", text)
    if match is None or not (seconds := float(match[1]) * _UNITS[match[2]]):
        raise TrainingError(f"--budget {text} is not valid: use e.g. 90s, 3m or 1h")
    return seconds


def run_folder(out: Path | None, name: str, *, resume: bool) -> Path:
    """Return the folder of a fit, found to be writable; it is not made.

    Args:
        out: folder that was asked for; None for one below ``runs``.
        name: name of the fit, for a folder that nobody asked for.
        resume: go on with the fit in it: the last one of that name where nobody asked for one.

    Raises:
        TrainingError: the folder holds a fit already, or none to go on with.
    """
    if out is None:
        numbered = [RUNS / name, *(RUNS / f"{name}-{number}" for number in range(2, 10_000))]
        free = next(index for index, folder in enumerate(numbered) if not folder.exists())
        folder = numbered[max(0, free - 1) if resume else free]
    else:
        folder = out
    check_folder("--out", folder)
    require(folder.suffix != ".veilcam", f"--out {folder} is not valid: give a folder")
    begun = (folder / "work").is_dir()
    require(begun or not resume, f"{folder} holds no fit to go on with: leave out --resume")
    require(
        resume or not folder.exists() or not any(folder.iterdir()),
        f"--out {folder} holds files: go on with --resume, or use another folder",
    )
    return folder


def _sentences(result: FitResult | FreshResult, bundle: Bundle | None) -> list[str]:
    accuracy = result.accuracy
    said = [f"test {100 * accuracy.value:.2f} % of {accuracy.samples} pictures"]
    if isinstance(result, FreshResult):
        said[0] += (
            f" on {result.masks} unseen masks "
            f"({100 * result.wrong_key_accuracy:.2f} % decoded with another key)"
        )
    if result.light is not None:
        error = result.transfer_error if isinstance(result, FitResult) else None
        said.append(light_line(result.light, error))
    if bundle is None:
        said.append("no bundle: a device cannot show this camera")
    return said


def _report(
    folder: Path,
    title: str,
    result: FitResult | FreshResult,
    source: Source,
    hidden: Sequence[str],
) -> None:
    from veilcam_training.experiments.report import Report, write_report  # noqa: PLC0415 - slow

    history, settings = result.fit.history, result.settings
    first = history[0]
    report = Report(
        title=title,
        facts=_facts(settings, result),
        sentences=hidden,
        labels=source.labels,
        history=history,
        images=source.test(),
        logits=result.logits,
        preparation=max(0.0, first.processor_seconds - first.seconds),
    )
    write_report(folder, report)


def _facts(settings: FitSettings, result: FitResult | FreshResult) -> list[tuple[str, str]]:
    best, last = result.fit.best, result.fit.history[-1]
    return [
        ("epoch", f"{best.number + 1} of {result.fit.epochs}, chosen on the validation part"),
        ("validation", f"{100 * best.validation_accuracy:.2f} %"),
        ("processor time", minutes(last.processor_seconds)),
        ("batch, rate", f"{settings.batch}, {settings.rate:g}"),
        ("noise", _noise(settings.snr_db)),
    ]


def _noise(snr_db: float | str | None) -> str:
    if snr_db is None:
        return "none"
    return snr_db if isinstance(snr_db, str) else f"{snr_db:g} dB"


def _next(folder: Path, bundle: Bundle | None) -> str:
    if bundle is None:
        return f"accuracies of every epoch: {folder}/history.csv"
    return f"try it: veilcam-train predict {folder}/{BUNDLE} PICTURE..."
