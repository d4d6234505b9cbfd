"""``veilcam-optics plan``: what to compute for a camera and a scene, how finely, and why."""

import math
from typing import Annotated

import typer
from rich.console import Console

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene
from veilcam_optics.camera.imperfections import Conditions, Imperfections
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan import plan
from veilcam_optics.plan.planning import explanation

Length = Annotated[float, typer.Option(metavar="METRES")]


def print_plan(
    *,
    embedding: Annotated[str, typer.Option(metavar="ROWSxCOLUMNS")] = "24x32",
    tolerance: Annotated[float, typer.Option(help="Relative L2 error at the embedding.")] = 1e-3,
    scene: Annotated[str, typer.Option(metavar="ROWSxCOLUMNS")] = "28x28",
    scene_height: Length = 0.12,
    scene_distance: Length = 0.40,
    distance: Annotated[float, typer.Option(help="Mask to sensor [m].")] = 4e-3,
    filters: Annotated[bool, typer.Option(help="Whether the panel has colour filters.")] = True,
    leakage: Annotated[float, typer.Option(help="Amplitude that filters leak.")] = 0.0,
    bandwidth: Annotated[float, typer.Option(help="Of each channel, FWHM [m].")] = 0.0,
    depth_range: Length = 0.0,
    off_axis: Annotated[
        float | None, typer.Option(help="Half the field of view [rad]; the scene's own by default.")
    ] = None,
    gamma: float = 1.0,
    contrast_floor: Annotated[float, typer.Option(help="Amplitude of a dark sub-pixel.")] = 0.0,
    levels: Annotated[int, typer.Option(help="Amplitudes the panel can show; 0 for any.")] = 0,
    shift_y: Length = 0.0,
    shift_x: Length = 0.0,
    rotation: Annotated[float, typer.Option(help="Of the mask [rad].")] = 0.0,
    distance_error: Length = 0.0,
    stray_light: Annotated[float, typer.Option(help="Share of all light.")] = 0.0,
    bayer: Annotated[bool, typer.Option(help="One colour per sensor pixel.")] = False,
    snr_db: Annotated[float, typer.Option(help="Of shot noise; inf for none.")] = math.inf,
    electrons: Annotated[float, typer.Option(help="In an embedding value of 1.")] = 0.0,
    read_noise: Annotated[float, typer.Option(help="[electrons]")] = 0.0,
    full_well: Annotated[float, typer.Option(help="[electrons]")] = 0.0,
    adc_bits: int = 0,
    black_level: Annotated[float, typer.Option(help="[embedding value]")] = 0.0,
    batch: Annotated[int, typer.Option(help="Scenes embedded with one mask.")] = 64,
) -> None:
    """Print the cheapest way to compute embeddings to within a tolerance, effect by effect."""
    console = Console()
    try:
        rows, columns = _shape("embedding", embedding)
        scene_rows, scene_columns = _shape("scene", scene)
        chosen = plan(
            Camera(
                panel=Panel(filter_cycle=(0, 1, 2) if filters else (), filter_leakage=leakage),
                distance=distance,
            ),
            Scene(scene_rows, scene_columns, scene_height, scene_distance),
            Embedding(rows, columns),
            tolerance,
            Conditions(
                bandwidth=(bandwidth,) * 3,
                depth_range=depth_range,
                off_axis=off_axis,
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


def _shape(argument: str, text: str) -> tuple[int, int]:
    rows, separator, columns = text.partition("x")
    if not (separator and rows.isascii() and rows.isdigit() and columns.isdigit()):
        raise OpticsError(f"--{argument} = {text} is not valid: use ROWSxCOLUMNS, like 24x32")
    return int(rows), int(columns)
