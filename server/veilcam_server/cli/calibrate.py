"""``veilcamd calibrate``: measure the camera with itself, and keep what was found."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from veilcam_server.cli import options
from veilcam_server.cli.terminal import AsBuiltOption, StateDirOption, fail, one_line
from veilcam_server.errors import CalibrationError, FenceError, StartError
from veilcam_server.settings import Settings


def calibrate(
    *,
    bundle: Annotated[
        Path | None,
        typer.Option(help="Whose camera it is. With --simulate, the demo's by default."),
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Measure the simulated panel and sensor.")
    ] = False,
    as_built: AsBuiltOption = None,
    state_dir: StateDirOption = None,
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
    panel_tab: options.PanelTab = None,
    spi: options.Spi = None,
    spi_hz: options.SpiClock = None,
    allow_fast_spi: options.FastSpi = False,
    gpio_chip: options.GpioChip = None,
    data_line: options.DataLine = None,
    reset_line: options.ResetLine = None,
    camera_number: options.CameraNumber = None,
    settle: Annotated[
        float | None, typer.Option(help="Seconds; settling may take three times as long.")
    ] = None,
    exposure: Annotated[
        float | None, typer.Option(help="Seconds, as the daemon will have it.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Exposures for one reading.")] = 2,
) -> None:
    """Measure settling, black level, gain, the panel's response, dead lines, and where the mask is.

    Three scenes are asked for: darkness, a white card, and a small lamp. The camera must be free:
    stop the daemon first, and start it again afterwards. Takes a few minutes.
    """
    # Imported late: --help need not wait for torch and matplotlib.
    from rich.console import Console  # noqa: PLC0415

    from veilcam_server.cli.calibration_session import calibrate_device  # noqa: PLC0415
    from veilcam_server.devices.errors import DeviceError  # noqa: PLC0415
    from veilcam_training.bundle import BundleError  # noqa: PLC0415

    given: dict[str, Any] = {
        "bundle": bundle,
        "device": "simulated" if simulate else None,
        "as_built": as_built,
        "state_dir": state_dir,
        "panel_tab": panel_tab,
        "spi": spi,
        "spi_hz": spi_hz,
        "allow_fast_spi": allow_fast_spi or None,
        "gpio_chip": gpio_chip,
        "data_line": data_line,
        "reset_line": reset_line,
        "camera_number": camera_number,
        "settle": settle,
        "exposure": exposure,
    }
    try:
        settings = Settings(**{name: value for name, value in given.items() if value is not None})
        calibrate_device(
            settings, Console(), out=out, picture=picture, frame=frame, repeats=repeats
        )
    except ValidationError as error:
        fail(one_line(error))
    except (StartError, CalibrationError, DeviceError, FenceError, BundleError) as error:
        fail(f"{error}; nothing was changed")
    except KeyboardInterrupt:
        raise SystemExit(130) from None
