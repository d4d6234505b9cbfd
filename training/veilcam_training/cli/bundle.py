"""``veilcam-train bundle``: what one is, and versions and signatures of an owner."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from veilcam_training.bundle import (
    Bundle,
    LightPlan,
    OwnerKey,
    TransferError,
    read_bundle,
    read_key,
    sentences,
    sign_bundle,
    write_key,
)

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="See what a bundle is; give it a version and a signature, for daemons that ask for one.",
)
console = Console(soft_wrap=True, highlight=False)

File = Annotated[Path, typer.Argument(help="A bundle, *.veilcam; it is replaced.")]
Version = Annotated[
    int, typer.Option("--version", min=1, help="Higher than that of every bundle before it.")
]


@app.command()
def keygen(
    key: Annotated[Path, typer.Argument(help="New file, PEM; its owner alone may read it.")],
) -> None:
    """Make the key that bundles are signed with. Keep it off the camera."""
    owner = write_key(key)
    console.print(f"wrote {key}; a line for the file that is --owner-keys of veilcamd:")
    _show(owner)


@app.command()
def sign(
    file: File,
    *,
    key: Annotated[Path, typer.Option("--key", help="Made by 'veilcam-train bundle keygen'.")],
    version: Version,
) -> None:
    """Sign a bundle with its owner's key, under a version."""
    sign_bundle(file, version, read_key(key))
    bundle = read_bundle(file)
    console.print(f"{file} is version {bundle.version}, {bundle.digest[:12]}, signed by")
    if bundle.owner is not None:
        _show(bundle.owner)


@app.command("version")
def give_version(file: File, *, version: Version) -> None:
    """Give a bundle a version, and take its signature away if it has one."""
    sign_bundle(file, version, None)
    bundle = read_bundle(file)
    console.print(f"{file} is version {bundle.version}, {bundle.digest[:12]}, not signed")


@app.command("show")
def show_command(
    file: Annotated[Path, typer.Argument(help="A bundle, *.veilcam; it stays as it is.")],
) -> None:
    """Print what a bundle is; none of it is secret."""
    bundle = read_bundle(file)
    pairs = f", {len(bundle.pairs)} masks" if bundle.pairs else ""
    console.print(f"{bundle.task}, {bundle.embedding}, mode {bundle.mode}{pairs}", markup=False)
    console.print(f"version {bundle.version}, {bundle.digest[:12]}")
    if bundle.owner is None:
        console.print("not signed")
    else:
        _show(bundle.owner)
    if bundle.accuracy is not None:
        named = f"{bundle.accuracy.test_set} ({bundle.accuracy.samples})"
        console.print(f"accuracy {100 * bundle.accuracy.value:.2f} % on {named}", markup=False)
    console.print(light_line(bundle.light, bundle.transfer_error))
    show_hiding(console, bundle)


def show_hiding(console: Console, bundle: Bundle) -> None:
    """Print what a bundle's masks hide, and from whom."""
    record = bundle.valid_hiding
    lines = ("hiding: not measured",) if record is None else sentences(record)
    console.print("\n".join(lines), soft_wrap=True, highlight=False)


def light_line(plan: LightPlan | None, error: TransferError | None) -> str:
    """Return the line on the light of a fit or a bundle.

    Args:
        plan: plan of the light; None where there is none.
        error: error of the worst mask; None where it was not measured.
    """
    told = "not planned"
    if plan is not None:
        reached = "reached" if plan.reached else "NOT reached: this is the most accurate setting"
        zones = "1 zone" if plan.zones == 1 else f"{plan.zones} x {plan.zones} zones"
        reach = f"reach {plan.reach.rows} rows {plan.reach.columns} columns"
        told = (
            f"planned to {plan.tolerance:.1e}, predicted error {plan.error:.1e} ({reached}), "
            f"{zones}, {reach if plan.diffraction else 'geometric shadows'}"
        )
    checked = "" if error is None else f"; worst mask by check: error {error}"
    return f"light: {told}{checked}"


def _show(owner: OwnerKey) -> None:
    console.print(f"{owner} {owner.short}")
