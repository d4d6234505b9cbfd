"""``veilcam-optics plan``: what to compute for a camera and a scene, how finely, and why."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from veilcam_optics.camera.description import read_camera
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import Conditions, Imperfections
from veilcam_optics.camera.presets import PRESETS, preset
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan import plan
from veilcam_optics.plan.planning import explanation

CAMERA_HELP = f"A TOML file, or {', '.join(PRESETS)}; `veilcam-optics camera` writes one."


def print_plan(
    *,
    camera: Annotated[str, typer.Option(metavar="FILE", help=CAMERA_HELP)] = "paper",
    embedding: Annotated[
        str,
        typer.Option(
            metavar="ROWSxCOLUMNS[@FILL]",
            help="Values read of a scene; FILL is the side of the averaged boxes, 1 by default.",
        ),
    ] = "24x32",
    tolerance: Annotated[float, typer.Option(help="Relative L2 error at the embedding.")] = 1e-3,
    scene: Annotated[
        str, typer.Option(metavar="ROWSxCOLUMNS", help="Pixels of the scene.")
    ] = "28x28",
    scene_height: Annotated[float, typer.Option(help="Of the scene [m].")] = 0.12,
    scene_distance: Annotated[float, typer.Option(help="Scene to mask [m].")] = 0.40,
    distance: Annotated[
        float | None, typer.Option(help="Mask to sensor [m]; the camera's own by default.")
    ] = None,
    filters: Annotated[
        bool, typer.Option(help="Whether to keep the panel's colour filters, if it has some.")
    ] = True,
    leakage: Annotated[
        float | None, typer.Option(help="Amplitude that filters leak, 0 to 1.")
    ] = None,
    bandwidth: Annotated[float, typer.Option(help="Of each channel, FWHM [m].")] = 0.0,
    depth_range: Annotated[float, typer.Option(help="Of the scene [m].")] = 0.0,
    gamma: Annotated[
        float, typer.Option(help="Exponent of the panel's response, 0.1 to 10.")
    ] = 1.0,
    contrast_floor: Annotated[
        float, typer.Option(help="Amplitude of a dark sub-pixel, 0 to 0.99.")
    ] = 0.0,
    levels: Annotated[int, typer.Option(help="Amplitudes the panel can show; 0 for any.")] = 0,
    shift_y: Annotated[float, typer.Option(help="Of the mask, down [m].")] = 0.0,
    shift_x: Annotated[float, typer.Option(help="Of the mask, across [m].")] = 0.0,
    rotation: Annotated[float, typer.Option(help="Of the mask [rad].")] = 0.0,
    distance_error: Annotated[float, typer.Option(help="Sensor too far by so much [m].")] = 0.0,
    stray_light: Annotated[float, typer.Option(help="Share of all light, 0 to 1.")] = 0.0,
    bayer: Annotated[bool, typer.Option(help="One colour per sensor pixel.")] = False,
    snr_db: Annotated[
        float, typer.Option(help="Signal to shot noise [dB]; inf for none.")
    ] = math.inf,
    electrons: Annotated[float, typer.Option(help="In an embedding value of 1 [electrons].")] = 0.0,
    read_noise: Annotated[float, typer.Option(help="Standard deviation [electrons].")] = 0.0,
    full_well: Annotated[float, typer.Option(help="At which a value saturates [electrons].")] = 0.0,
    adc_bits: Annotated[int, typer.Option(help="Of the converter [bits]; 0 for none.")] = 0,
    black_level: Annotated[float, typer.Option(help="Offset [embedding value].")] = 0.0,
    batch: Annotated[int, typer.Option(help="Scenes embedded with one mask.")] = 64,
) -> None:
    """Print the cheapest way to compute embeddings to within a tolerance, effect by effect."""
    console = Console()
    try:
        scene_rows, scene_columns = _shape("scene", scene)
        chosen = plan(
            _camera(camera, distance=distance, filters=filters, leakage=leakage),
            Scene(scene_rows, scene_columns, scene_height, scene_distance),
            _embedding(embedding),
            tolerance,
            Conditions(
                bandwidth=(bandwidth,) * 3,
                depth_range=depth_range,
                imperfections=Imperfections(
                    gamma=gamma,
                    contrast_floor=contrast_floor,
                    shift_y=shift_y,
                    shift_x=shift_x,
                    rotation=rotation,
                    distance_error=distance_error,
                    stray_light=stray_light,
                ),
                levels=levels,
                bayer=bayer,
                snr_db=snr_db,
                electrons=electrons,
                read_noise=read_noise,
                full_well=full_well,
                adc_bits=adc_bits,
                black_level=black_level,
            ),
            batch=batch,
        )
    except OpticsError as error:
        Console(stderr=True).print(f"error: {error}", markup=False, highlight=False)
        raise typer.Exit(2) from None
    console.print(explanation(chosen, max(80, console.width)), markup=False, highlight=False)


def _camera(source: str, *, distance: float | None, filters: bool, leakage: float | None) -> Camera:
    """Return the camera of a preset's name or a file, with the changes of the command line."""
    camera = preset(source) if source in PRESETS else read_camera(Path(source))
    panel = camera.panel
    if not filters:
        panel = replace(panel, filter_cycle=(), filter_leakage=0.0, filter_amplitudes=())
    if leakage is not None:
        panel = replace(panel, filter_leakage=leakage, filter_amplitudes=())
    return replace(camera, panel=panel, distance=camera.distance if distance is None else distance)


def _embedding(text: str) -> Embedding:
    try:
        return Embedding.parse(text)
    except OpticsError as error:
        raise OpticsError(f"--{error}") from None


def _shape(argument: str, text: str) -> tuple[int, int]:
    rows, separator, columns = text.partition("x")
    if not (separator and rows.isascii() and rows.isdigit() and columns.isdigit()):
        raise OpticsError(f"--{argument} = {text} is not valid: use ROWSxCOLUMNS, like 24x32")
    return int(rows), int(columns)
