"""``veilcam calibrate``: a daemon's camera measured with itself, over its API."""

import time
from contextlib import suppress
from typing import Annotated

import typer

from veilcam_client.camera import Camera
from veilcam_client.cli.format import record_in_words, run_in_words
from veilcam_client.cli.terminal import DEVICE, Ask, asking, fail
from veilcam_client.errors import VeilcamError
from veilcam_client.wire.calibration import CalibrationRun

_EVERY = 0.5
"""Between two looks at how it goes on [s]."""


@asking()
def calibrate(
    ask: Ask,
    *,
    repeats: Annotated[
        int, typer.Option(min=1, max=100, help="Exposures for one measurement.")
    ] = 2,
) -> None:
    """Measure the camera with itself; it takes no captures meanwhile, for some minutes.

    Three scenes are asked for: darkness, a white card, and a small lamp. The daemon uses what is
    found from then on. Wants a token of the scope calibrate; Ctrl-C ends it, and nothing changes.
    Where no daemon runs: 'veilcamd calibrate' on the device.
    """
    with ask.camera() as camera:
        run = camera.calibration.start(repeats=repeats)
        try:
            run = _follow(camera, run)
        except BaseException:
            # It may have ended by itself, or the daemon be gone.
            with suppress(VeilcamError):
                camera.calibration.cancel()
            raise
        found = camera.calibration.get()
    if run.stage != "done":
        fail(f"{run.detail or 'the calibration was cancelled'}; nothing was changed", DEVICE)
    if ask.json:
        typer.echo(found.model_dump_json())
    elif found.signed is not None:
        typer.echo(record_in_words(found.signed.record))


def _follow(camera: Camera, run: CalibrationRun) -> CalibrationRun:
    """Ask for scenes until it has ended, and say on the way how it goes on."""
    said: object = None
    while run.stage in ("waiting", "measuring", "fitting"):
        if run.stage == "waiting" and run.scene is not None:
            typer.echo(f"\n{run.instruction}", err=True)
            typer.prompt("Press Enter when it is so", default="", show_default=False, err=True)
            run = camera.calibration.confirm(run.scene)
            continue
        if (news := (run.stage, run.scene, 10 * run.exposures // max(1, run.total))) != said:
            typer.echo(run_in_words(run), err=True)
            said = news
        time.sleep(_EVERY)
        run = camera.calibration.get().run or run
    return run
