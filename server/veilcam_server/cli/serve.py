"""``veilcamd serve``: from options to a daemon."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from veilcam_client.wire.rotation import EveryCaptures, EverySeconds, RotationPolicy
from veilcam_server.cli import options
from veilcam_server.cli.terminal import AsBuiltOption, fail, one_line
from veilcam_server.demo_data import Digits, load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.errors import StartError, StoppedError
from veilcam_server.settings import Settings
from veilcam_server.system import logs


def serve(
    *,
    bundle: Annotated[
        Path | None,
        typer.Option(
            help="Masks and classifiers, a *.veilcam file. With --simulate, the demo's by default."
        ),
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Use a simulated panel and sensor.")
    ] = False,
    scenes: Annotated[
        list[str] | None,
        typer.Option(
            help="What the simulated camera sees: an image (.npy, PNG, JPEG), a folder of images, "
            "or a data set as mnist:FOLDER or mnist:FOLDER:test. Give several, and each capture "
            "sees the next. Default: what 'veilcamd show' holds up.",
            metavar="PATH",
        ),
    ] = None,
    scene_api: Annotated[
        bool,
        typer.Option(
            "--scene-api", help="Let callers hold scenes up before the simulated camera, for tests."
        ),
    ] = False,
    replay: Annotated[
        Path | None,
        typer.Option(
            help="Answer with what 'veilcam record' wrote to this file, instead of a camera."
        ),
    ] = None,
    host: Annotated[
        str | None, typer.Option(help="Address to listen on; others than loopback need TLS.")
    ] = None,
    port: Annotated[int | None, typer.Option(help="Port; 0 takes a free one.")] = None,
    socket: Annotated[Path | None, typer.Option(help="Listen on a unix socket instead.")] = None,
    state_dir: Annotated[Path | None, typer.Option(help="Where mask epochs are recorded.")] = None,
    every_seconds: Annotated[
        float | None, typer.Option(help="Change the mask every so many seconds.")
    ] = None,
    every_captures: Annotated[
        int | None, typer.Option(help="Change the mask every so many captures.")
    ] = None,
    jitter: Annotated[
        float | None,
        typer.Option(help="With --every-seconds: up to so many seconds less, by chance."),
    ] = None,
    reuse: Annotated[
        int | None,
        typer.Option(
            help="Captures that a mask may still serve when the next is not ready; 0 waits."
        ),
    ] = None,
    mask_secret: Annotated[
        Path | None,
        typer.Option(help="File with the secret of fresh masks, made by 'veilcamd secret'."),
    ] = None,
    device_label: Annotated[
        str | None,
        typer.Option(help="Label of this camera: no two with one secret may have the same."),
    ] = None,
    release: Annotated[
        str | None,
        typer.Option(
            help="How embeddings leave: none, flat, white or raw. Default: white for fresh masks, "
            "none for pairs (raw when simulated)."
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="Record of 'veilcamd calibrate'; by default the one in the state directory, "
            "if there is one."
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
    exposure_factor: options.ExposureFactor = None,
    settle: Annotated[
        float | None,
        typer.Option(help="Seconds for the panel to settle, never less than was measured."),
    ] = None,
    exposure: Annotated[float | None, typer.Option(help="Exposure in seconds.")] = None,
    snr_db: Annotated[
        float | None, typer.Option(help="Simulated signal-to-noise ratio in dB.")
    ] = None,
    as_built: AsBuiltOption = None,
    self_test_every: Annotated[
        float | None, typer.Option(help="Seconds between two self tests of the panel, at most.")
    ] = None,
    queue_limit: Annotated[int | None, typer.Option(help="Captures that may wait.")] = None,
    auth: Annotated[
        str | None,
        typer.Option(
            help="tokens, or none: whoever reaches the daemon may use it. Default: tokens, "
            "none when simulated."
        ),
    ] = None,
    tls_certificate: Annotated[
        Path | None, typer.Option(help="Serve TLS with this certificate, a PEM file.")
    ] = None,
    tls_key: Annotated[Path | None, typer.Option(help="Its private key, a PEM file.")] = None,
    wrong_classifier: Annotated[
        bool,
        typer.Option(
            "--wrong-classifier",
            help="Experiment: read every mask as if it were another one.",
        ),
    ] = False,
    log_level: Annotated[str | None, typer.Option(help="debug, info, warning or error.")] = None,
) -> None:
    """Serve the camera on this machine until interrupted.

    What is not given here is taken from the environment: VEILCAM_BUNDLE, VEILCAM_PORT, ...
    """
    # Imported late: --help need not wait for torch.
    from veilcam_server.daemon import serve as run  # noqa: PLC0415

    given: dict[str, Any] = {
        "bundle": bundle,
        "device": "simulated" if simulate else None,
        "scenes": scenes or None,
        "scene_api": scene_api or None,
        "replay": replay,
        "host": host,
        "port": port,
        "socket": socket,
        "state_dir": state_dir,
        "mask_secret": mask_secret,
        "device_label": device_label,
        "release": release,
        "calibration": calibration,
        "panel_tab": panel_tab,
        "spi": spi,
        "spi_hz": spi_hz,
        "allow_fast_spi": allow_fast_spi or None,
        "gpio_chip": gpio_chip,
        "data_line": data_line,
        "reset_line": reset_line,
        "camera_number": camera_number,
        "exposure_factor": exposure_factor,
        "settle": settle,
        "exposure": exposure,
        "snr_db": snr_db,
        "as_built": as_built,
        "self_test_every": self_test_every,
        "queue_limit": queue_limit,
        "auth": auth,
        "tls_certificate": tls_certificate,
        "tls_key": tls_key,
        "wrong_classifier": wrong_classifier or None,
        "log_level": log_level,
    }
    try:
        given["rotation"] = _policy(every_seconds, every_captures, jitter=jitter, reuse=reuse)
        settings = Settings(**{name: value for name, value in given.items() if value is not None})
        logs.configure(settings.log_level)
        simulated = settings.device == "simulated"  # as the environment may say too
        if simulated and not settings.scenes and not settings.scene_file.exists():
            hold_up(settings.scene_file, load_digits(), 0)
        run(settings, lambda url: print(f"veilcamd listening on {url}", flush=True))  # noqa: T201
    except ValidationError as error:
        fail(one_line(error))
    except (StartError, StoppedError) as error:
        fail(str(error))
    except KeyboardInterrupt:
        pass


def _policy(
    seconds: float | None, captures: int | None, *, jitter: float | None, reuse: int | None
) -> RotationPolicy | None:
    if seconds is not None and captures is not None:
        raise StartError("give --every-seconds or --every-captures, not both")
    if jitter is not None and seconds is None:
        raise StartError("--jitter goes with --every-seconds")
    if reuse is not None and seconds is None and captures is None:
        raise StartError("--reuse goes with --every-seconds or --every-captures")
    if seconds is not None:
        return EverySeconds(seconds=seconds, jitter=jitter or 0.0, reuse=reuse or 0)
    return None if captures is None else EveryCaptures(captures=captures, reuse=reuse or 0)


def hold_up(scene: Path, digits: Digits, index: int) -> None:
    """Write one digit to the scene file."""
    try:
        scene.parent.mkdir(parents=True, exist_ok=True)
        write_scene(scene, digits.images[index])
    except OSError as error:
        raise StartError(f"cannot write the scene {scene}: {error.strerror}") from None
