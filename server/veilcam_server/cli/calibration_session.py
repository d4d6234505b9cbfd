"""A calibration in a terminal: scenes set by hand, a bar, and the files it writes."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from veilcam_client.cli.format import record_in_words
from veilcam_client.wire.calibration import CalibrationRecord, CalibrationRun
from veilcam_optics.decoding import write_frame
from veilcam_server.calibration.procedure import Calibrated
from veilcam_server.calibration.record import RECORD_NAME, imperfections_of
from veilcam_server.calibration.service import CalibrationService
from veilcam_server.devices.registry import open_device
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.errors import StartError
from veilcam_server.sealing.identity import DeviceKey
from veilcam_server.settings import Settings
from veilcam_training.bundle import Bundle, read_bundle


def calibrate_device(
    settings: Settings,
    console: Console,
    *,
    out: Path | None,
    picture: Path | None,
    frame: Path | None,
    repeats: int,
) -> CalibrationRecord:
    """Measure the device that the settings name, and write record and picture.

    Args:
        settings: checked.
        console: console for instructions, progress and the result.
        out: record to write; by default that of the state directory.
        picture: picture to draw; beside the record by default, where matplotlib is installed.
        frame: frame of the camera as built, for decoding elsewhere; none by default.
        repeats: exposures for one measurement.

    Returns:
        What was measured.

    Raises:
        CalibrationError: the measurement is refused, or the record cannot be written.
        StartError: picture or frame cannot be written, or a bundle of pairs has no frame.
        BundleError, DeviceError, FenceError: bundle or device cannot be used.
    """
    out = out or settings.state_dir / RECORD_NAME
    draw = _drawing(wanted=picture is not None)
    picture = picture or out.with_suffix(".png")
    settings = settings.model_copy(update={"calibration": out})
    bundle = read_bundle(settings.bundle)
    if frame is not None and bundle.fresh is None:
        raise StartError("--frame is for fresh masks: this bundle holds pairs")
    service = CalibrationService(settings, bundle, DeviceKey.open(settings.state_dir))
    found = _measure(service, settings, bundle, console, repeats)
    service.write(service.sign(found.record))
    written = [out]
    try:
        if draw is not None:
            draw(picture, found)
            written.append(picture)
        if frame is not None and bundle.fresh is not None:
            drawn = bundle.fresh.frame(bundle.camera, bundle.scene, bundle.embedding)
            write_frame(frame, replace(drawn, imperfections=imperfections_of(found.record)))
            written.append(frame)
    except OSError as error:
        raise StartError(f"{error.filename} cannot be written ({error.strerror})") from None
    console.print(record_in_words(found.record), highlight=False, markup=False)
    for path in written:
        console.print(f"wrote {path}", highlight=False, soft_wrap=True)
    console.print("a daemon that starts now uses it", highlight=False)
    return found.record


def _drawing(*, wanted: bool) -> Callable[[Path, Calibrated], None] | None:
    """Return the function that draws the picture; None where none is possible or wanted."""
    try:
        from veilcam_server.calibration.plot import write_picture  # noqa: PLC0415 - an extra
    except ModuleNotFoundError as missing:
        if not wanted:
            return None
        raise StartError(
            f"--picture needs {missing.name}: run pip install -e '.[simulate]' in the checkout"
        ) from None
    return write_picture


def _measure(
    service: CalibrationService, settings: Settings, bundle: Bundle, console: Console, repeats: int
) -> Calibrated:
    """Measure what the settings name, with a person for the scenes that are not simulated."""
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
    )
    task = progress.add_task("")

    def report(state: CalibrationRun) -> None:
        if state.stage == "waiting" and state.scene is not None:
            progress.stop()
            console.print(f"\n{state.instruction}", highlight=False)
            console.input("Press Enter when it is so: ")
            run.confirm(state.scene)
            progress.start()
        else:
            progress.update(
                task, description=state.scene, completed=state.exposures, total=state.total
            )

    run = service.begin(repeats, report)
    with ExitStack() as stack:
        if settings.device == "simulated":
            # What is in front of a daemon's camera may be missing, and plays no part.
            directory = stack.enter_context(tempfile.TemporaryDirectory(prefix="veilcam-"))
            scene = Path(directory) / "scene.npy"
            settings = settings.model_copy(update={"scenes": (str(scene),)})
            write_scene(scene, np.zeros(bundle.scene.shape, np.uint8))
        device = open_device(settings, bundle)
        stack.callback(device.close)
        stack.enter_context(progress)
        return service.measure(device, run)
