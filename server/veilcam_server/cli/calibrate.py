"""``veilcamd calibrate``: measure the camera with itself, and keep what was found."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from veilcam_server.cli.options import options_of
from veilcam_server.cli.terminal import JsonOption, enter_state, fail, require_software
from veilcam_server.errors import CalibrationError, FenceError, StartError
from veilcam_server.settings import Settings
from veilcam_server.wiring import Wiring


@options_of(
    Settings,
    ("bundle", "device", "imperfections", "state_dir", "settle", "exposure", *Wiring.model_fields),
)
def calibrate(
    settings: Settings,
    *,
    out: Annotated[
        Path | None,
        typer.Option(help="Record to write; calibration.json in the state directory by default."),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Picture to draw; beside the record by default.")
    ] = None,
    frame: Annotated[
        Path | None,
        typer.Option(
            help="Also write the public frame of the camera as it was built, with which others "
            "decode what it releases."
        ),
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Exposures for one measurement.")] = 2,
    json: JsonOption = False,
) -> None:
    """Measure settling, black level, gain, the panel's response, dead lines, and where the mask is.

    Three scenes are asked for: darkness, a white card, and a small lamp. The camera must be free:
    stop the daemon first, and start it again afterwards. Takes a few minutes. With a daemon that
    runs, and from another machine: 'veilcam calibrate'.
    """
    # Imported late: --help need not wait for torch and matplotlib.
    from rich.console import Console  # noqa: PLC0415

    from veilcam_server.cli.calibration_session import calibrate_device  # noqa: PLC0415
    from veilcam_server.devices.errors import DeviceError  # noqa: PLC0415
    from veilcam_training.bundle import BundleError  # noqa: PLC0415

    enter_state(settings.state_dir)
    require_software()
    try:
        # What is asked of a person goes where a program that reads the record does not look.
        console = Console(stderr=json)
        record = calibrate_device(
            settings, console, out=out, picture=picture, frame=frame, repeats=repeats
        )
        if json:
            typer.echo(record.model_dump_json())
    except (StartError, CalibrationError, DeviceError, FenceError, BundleError) as error:
        fail(f"{error}; nothing was changed")
    except KeyboardInterrupt:
        raise SystemExit(130) from None
