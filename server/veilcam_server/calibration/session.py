"""A person, or a file, and a camera: what ``veilcamd calibrate`` does."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from veilcam_client.cli.format import record_in_words
from veilcam_optics.decoding import write_frame
from veilcam_optics.transfer.operator import Reach
from veilcam_server.calibration import (
    CalibrationScene,
    Effort,
    Geometry,
    SigningKey,
    calibrate,
    correction,
    sign_record,
    write_record,
)
from veilcam_server.calibration.loading import panel_tab
from veilcam_server.calibration.plot import write_picture
from veilcam_server.calibration.record import RECORD_NAME
from veilcam_server.calibration.workshop import LONGEST
from veilcam_server.devices.registry import open_device
from veilcam_server.devices.simulated.scenes import Scenes, write_scene
from veilcam_server.errors import StartError
from veilcam_server.settings import Settings
from veilcam_training.bundle import read_bundle


def calibrate_device(
    settings: Settings,
    console: Console,
    *,
    out: Path | None,
    picture: Path | None,
    frame: Path | None,
    repeats: int,
) -> None:
    """Measure the device that the settings name, and write record and picture.

    Args:
        settings: checked.
        console: for instructions, progress and the result.
        out: record to write; by default the one that the daemon reads.
        picture: to draw; beside the record by default.
        frame: of the camera as it was built, for whoever decodes elsewhere; none by default.
        repeats: exposures for one reading.

    Raises:
        CalibrationError: the measurement is refused, or the record cannot be written.
        StartError: picture or frame cannot be written, or a bundle of pairs has no frame.
        BundleError, DeviceError, FenceError: bundle or device cannot be used.
    """
    torch.set_num_threads(1)
    out = out or settings.state_dir / RECORD_NAME
    picture = picture or out.with_suffix(".png")
    # First of all: a disk that cannot be written should not be found out minutes later.
    key = SigningKey.open(settings.state_dir, create=True)
    bundle = read_bundle(settings.bundle)
    if frame is not None and bundle.fresh is None:
        raise StartError("--frame is for fresh masks: this bundle holds pairs")
    geometry = Geometry(bundle.camera, bundle.scene, bundle.embedding)
    effort = Effort(repeats=repeats)
    with ExitStack() as stack:
        if settings.device == "simulated":
            # What is in front of a daemon's camera may be missing, and plays no part.
            directory = stack.enter_context(tempfile.TemporaryDirectory(prefix="veilcam-"))
            scene = Path(directory) / "scene.npy"
            settings = settings.model_copy(update={"scenes": (str(scene),)})
            write_scene(scene, np.zeros(bundle.scene.shape, np.uint8))
        device = open_device(settings, bundle)
        held = device.scenes
        present = _by_hand(console) if held is None else partial(_hold_up, held)
        stack.callback(device.close)
        progress = stack.enter_context(
            Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
                console=console,
            )
        )
        task = progress.add_task("", total=effort.captures(geometry))

        def show(wanted: CalibrationScene) -> None:
            progress.stop()
            present(wanted)
            progress.update(task, description=wanted.name)
            progress.start()

        found = calibrate(
            device,
            geometry,
            show,
            longest=LONGEST * settings.settle,
            exposure=settings.exposure,
            tab=panel_tab(settings),
            reach=bundle.fresh.reach if bundle.fresh else Reach(),
            timeout=settings.capture_timeout,
            effort=effort,
            advance=lambda: progress.advance(task),
        )
    write_record(out, sign_record(found.record, key))
    written = [out, picture]
    try:
        write_picture(picture, found)
        if frame is not None and bundle.fresh is not None:
            drawn = bundle.fresh.frame(bundle.camera, bundle.scene, bundle.embedding)
            write_frame(frame, replace(drawn, calibration=correction(found.record)))
            written.append(frame)
    except OSError as error:
        raise StartError(f"{error.filename} cannot be written ({error.strerror})") from None
    console.print(record_in_words(found.record), highlight=False, markup=False)
    for path in written:
        console.print(f"wrote {path}", highlight=False, soft_wrap=True)
    console.print("a daemon that starts now uses it", highlight=False)


def _hold_up(held: Scenes, scene: CalibrationScene) -> None:
    """Hold a scene up before a simulated camera; what is in front of a daemon's stays there."""
    held.hold(scene.image)


def _by_hand(console: Console) -> Callable[[CalibrationScene], None]:
    """Ask for scenes."""

    def present(scene: CalibrationScene) -> None:
        console.print(f"\n{scene.instruction}", highlight=False)
        console.input("Press Enter when it is so: ")

    return present
