"""Whether captures prove their mask, in a world that shares no code with the test.

``python -m benchmarks.proof healthy runs/healthy --figures benchmarks/results/proof.json``
``python -m benchmarks.proof faulty runs/faulty --figures benchmarks/results/proof.json``
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.proof.bound import unexplained
from benchmarks.proof.captures import LEVELS
from benchmarks.proof.figures import (
    Counts,
    draw_shifts,
    fault_figures,
    fault_table,
    healthy_figures,
    worst_camera,
)
from benchmarks.proof.kinds import by_kind
from benchmarks.proof.runs import BUNDLES, Job, run
from benchmarks.proof.world import Extent, World

from veilcam_optics.proof import MaskTests
from veilcam_server.demo_data import load_digits
from veilcam_training.bundle import read_bundle

WorkArgument: TypeAlias = Annotated[
    Path, typer.Argument(help="Folder for what was counted: resumes what is in it.")
]
SeedOption: TypeAlias = Annotated[int, typer.Option(help="Of cameras, masks, scenes and noise.")]
WorkersOption: TypeAlias = Annotated[int, typer.Option(min=1, help="Processes at once.")]
TintOption: TypeAlias = Annotated[
    float, typer.Option(min=0, help="Spread of lamps' colours, as logarithm of a channel's light.")
]
ElectronsOption: TypeAlias = Annotated[
    float | None, typer.Option(min=1, help="Of a bin at full scale; drawn where none is given.")
]

SENSORS, PAPERS = 3e7, 2.5e3
"""Electrons of a bin at full scale: what an IMX477 holds, and 40 dB at 24 x 32."""
TELLING = ("digit", "natural")
"""What the shipped bundles look at, and what the world looks like."""

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False)


def shipped_tests(world: World) -> MaskTests:
    """Tests as a daemon makes them: of what a calibration found."""
    build = world.build
    return MaskTests(
        build.camera,
        imperfections=world.belief.imperfections,
        # As well as the black level is known, see draw_belief.
        dark=2e-5 * build.full_scale,
    )


@app.command()
def healthy(
    work: WorkArgument,
    *,
    cameras: Annotated[int, typer.Option(min=1)] = 306,
    masks: Annotated[int, typer.Option(min=1, help="Of each camera.")] = 6,
    captures: Annotated[int, typer.Option(min=1, help="Behind each mask.")] = 561,
    tint: TintOption = 0.0,
    electrons: ElectronsOption = None,
    seed: SeedOption = 1,
    workers: WorkersOption = 1,
    figures: FiguresOption = None,
) -> None:
    """Count false alarms of cameras whose panel shows what it is told."""
    extent = Extent(masks=masks, captures=captures, tint=tint, electrons=electrons)
    # Masks that never come again are two thirds of them.
    bundles = [tuple(BUNDLES)[number % 3 == 2] for number in range(cameras)]
    jobs = [Job("healthy", bundle, seed, number, extent) for number, bundle in enumerate(bundles)]
    tallies = run(work, jobs, shipped_tests, workers)
    for level in LEVELS:
        print(f"{level:8}", Counts.of(tallies, "healthy", [level]))
    worst = worst_camera(tallies)
    print("worst camera:", worst.job["bundle"], worst.job["number"], worst.least_margin)
    for told in worst.told:
        print("  ", told)
    values = healthy_figures(tallies)
    print(values)
    record(figures, values)


@app.command()
def faulty(
    work: WorkArgument,
    *,
    cameras: Annotated[int, typer.Option(min=1, help="With each bundle.")] = 50,
    masks: Annotated[int, typer.Option(min=1, help="Of each camera.")] = 2,
    captures: Annotated[int, typer.Option(min=3, help="Behind each fault of each mask.")] = 30,
    tint: TintOption = 0.0,
    electrons: ElectronsOption = None,
    seed: SeedOption = 1,
    workers: WorkersOption = 1,
    picture: Annotated[Path | None, typer.Option(help="To draw the curve of shifts.")] = None,
    figures: FiguresOption = None,
) -> None:
    """Count faults that are found in the first capture."""
    extent = Extent(
        masks=masks, captures=captures, objects=8, surroundings=8, tint=tint, electrons=electrons
    )
    jobs = [
        Job("faulty", bundle, seed, number, extent)
        for bundle in BUNDLES
        for number in range(cameras)
    ]
    tallies = run(work, jobs, shipped_tests, workers)
    table = fault_table(tallies)
    for place, counts in table.items():
        print("{:6} {:9} {:7}".format(*place), counts)
    if picture is not None:
        draw_shifts(tallies, picture)
    values = fault_figures(table)
    print(values)
    record(figures, values)


@app.command()
def kinds(
    *,
    cameras: Annotated[int, typer.Option(min=1)] = 6,
    bundle: Annotated[str, typer.Option(help="Name of a shipped bundle.")] = "fresh",
    seed: SeedOption = 1,
    figures: FiguresOption = None,
) -> None:
    """Show what can be decided in which scene."""
    shares = by_kind(
        read_bundle(BUNDLES[bundle]),
        load_digits(),
        shipped_tests,
        cameras=cameras,
        electrons=(SENSORS, PAPERS),
        seed=seed,
    )
    for share in shares:
        numbers = f"seen {share.seen:4.0%}  accused {share.accused:4.0%}  found {share.found:4.0%}"
        print(f"{share.kind:20} {share.electrons:9.2g} electrons: {numbers}")
    telling = [share for share in shares if share.kind in TELLING and share.electrons == SENSORS]
    record(
        figures,
        {
            "proof_seen_in_telling_scenes": min(share.seen for share in telling),
            "proof_found_in_telling_scenes": min(share.found for share in telling),
        },
    )


@app.command()
def bound(
    *,
    cameras: Annotated[int, typer.Option(min=1)] = 6,
    bundle: Annotated[str, typer.Option(help="Name of a shipped bundle.")] = "fresh",
    seed: SeedOption = 1,
) -> None:
    """Show what of a capture no such scene behind another mask explains."""
    for each in unexplained(
        read_bundle(BUNDLES[bundle]), load_digits(), cameras=cameras, electrons=SENSORS, seed=seed
    ):
        where = "half space" if each.outdoors else "room"
        numbers = f"smooth {each.excess:9.2g}  copies {each.copied:9.2g}"
        print(f"{each.kind:20} {where:10} {numbers} chi-square per bin")


if __name__ == "__main__":
    app()
