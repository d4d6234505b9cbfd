"""Table 5: scenes recovered by convex optimisation, with the right PSF and with another mask's."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.keys.options import shown_progress
from benchmarks.privacy.paper.cells import (
    EXAMPLES,
    Cells,
    DataOption,
    PicturesOption,
    SourceOption,
    Values,
    WorkOption,
    difference,
    gray,
    likeness,
    mean,
    mean_picture,
    one_of_each,
    proven,
    published,
    row,
)
from benchmarks.privacy.paper.convex_attack import (
    BinnedConvolution,
    ConvexAttack,
    Normal,
    descend,
    psf_samples,
    tune,
)
from benchmarks.privacy.paper.pictures import draw, kept
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Scene
from veilcam_optics.camera.masks import random_mask
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.grid import GridLight
from veilcam_training.attacks.metrics import psnr
from veilcam_training.data import open_source
from veilcam_training.seeding import stream

SENSOR = (768, 1024)
"""Samples on the sensor: every size of the table divides them."""
SIZES = ((384, 512), (192, 256), (96, 128), (48, 64), (24, 32), (6, 8), (3, 4))
SNR_DB = 40.0
TUNED_ON, UNTUNED_ON = 8, 16
"""Pictures."""
MOST_PIXELS = 5000
UNTUNED = ConvexAttack(0.0, 300, 1.0)
"""As far as 300 iterations go, without regularisation: what noise does to an attacker who does not
look."""
CONVERGED, INNER = 400, 40
"""Iterations, and dual steps in each, of the run that shows that a minimum is reached."""


def command(
    *,
    data: DataOption,
    source: SourceOption = "faces-gender",
    work: WorkOption = Path("runs/paper-convex"),
    count: Annotated[int, typer.Option(min=2, help="Pictures that are attacked.")] = 50,
    size: Annotated[
        list[str] | None, typer.Option(help="Embedding, as 24x32; all by default.")
    ] = None,
    figures: FiguresOption = None,
    pictures: PicturesOption = None,
) -> None:
    """Recover pictures that the attacker never saw; settings are tuned on others."""
    opened = open_source(source, data)
    scene = opened.scene
    if scene.rows * scene.columns > MOST_PIXELS:
        raise typer.BadParameter(f"{source} has more than {MOST_PIXELS} pixels: use smaller ones")
    names = size or [f"{rows}x{columns}" for rows, columns in SIZES]
    known = {f"{rows}x{columns}": (rows, columns) for rows, columns in SIZES}
    if not set(names) <= known.keys():
        raise typer.BadParameter(f"sizes are {', '.join(known)}: use some of them")
    tuned, test = opened.training(), opened.test()
    own = gray(tuned, one_of_each(tuned, TUNED_ON, "convex", "tune"))
    truth = gray(test, one_of_each(test, count, "convex", "test"))
    cells = Cells(work, {"source": source, "count": count, "tuned_on": TUNED_ON})
    psfs = {name: masks_psf(scene, name) for name in ("good", "bad")}
    found: dict[str, Values] = {}
    with shown_progress() as progress:
        task = progress.add_task("cells", total=2 * len(names))
        for name in names:
            for kind in ("good", "bad"):
                progress.update(task, description=f"{kind} {name}")
                cell = partial(attack, psfs, kind, known[name], own, truth)
                found[f"{kind}_{name}"] = cells.get(f"{kind}_{name}", cell)
                progress.advance(task)
    guess = psnr(mean_picture(opened).expand_as(truth), truth).tolist()
    tell(found, names, guess)
    record(figures, as_figures(found, names, guess))
    if pictures is not None:
        columns = [truth[:EXAMPLES]] + [kept(found[f"good_{name}"]["pictures"]) for name in names]
        draw(pictures / "convex-good.png", ["scene", *names], columns)
        columns = [truth[:EXAMPLES]] + [kept(found[f"bad_{name}"]["pictures"]) for name in names]
        draw(pictures / "convex-bad.png", ["scene", *names], columns)


def sampled(scene: Scene, camera: Camera) -> tuple[int, float]:
    """Samples along a scene pixel's image, a whole number of them, and the side of one [m]."""
    pitch = camera.sensor.height / SENSOR[0]
    return max(1, round(scene.pixel_at_sensor(camera) / pitch)), pitch


def masks_psf(scene: Scene, purpose: str) -> Tensor:
    """The gray PSF of a random mask, for all offsets between sensor and scene."""
    camera = Camera()
    side, pitch = sampled(scene, camera)
    grid = Grid.square(*psf_samples(scene.shape, SENSOR, side=side, binning=(1, 1)), pitch)
    light = GridLight(camera, scene, dtype=torch.float32, grid=grid)
    channels = light.psf(random_mask(camera, stream(1, "convex", purpose)))
    shares = torch.tensor(camera.sensor.channel_weights)
    return torch.einsum("c,cyx->yx", shares, channels).clamp_min(0)


def attack(
    psfs: dict[str, Tensor], kind: str, size: tuple[int, int], own: Tensor, truth: Tensor
) -> Values:
    """One cell: measured behind the mask ``good``, attacked as if behind ``kind``."""
    scene = (int(truth.shape[1]), int(truth.shape[2]))
    side = (psfs[kind].shape[0] + 1 - SENSOR[0]) // scene[0]
    binning = (SENSOR[0] // size[0], SENSOR[1] // size[1])
    camera, assumed = (
        BinnedConvolution(psfs[each], scene, size, side=side, binning=binning)
        for each in ("good", kind)
    )
    light = camera.forward(torch.cat([own, truth])).clamp_min(0)
    embeddings = shot_noise(light, SNR_DB, stream(1, "convex", "noise", *size))
    normal, seen = Normal(assumed), embeddings[len(own) :]
    settings = tune(normal, embeddings[: len(own)], own)
    recovered, untuned = settings(normal, seen), UNTUNED(normal, seen[:UNTUNED_ON])
    (minimum,) = descend(normal, seen[:1], settings.variation, (CONVERGED,), inner=INNER)
    return {
        **likeness(recovered.scenes, truth),
        "settings": asdict(settings),
        "gap": float(recovered.gap.median()),
        "untuned": likeness(untuned.scenes, truth[:UNTUNED_ON]),
        "untuned_gap": float(untuned.gap.median()),
        "converged_gap": float(minimum.gap.max()),
    }


def tell(found: dict[str, Values], names: list[str], guess: list[float]) -> None:
    """Print the table beside the paper's, and which differences are proven."""
    paper = published()
    for kind in ("good", "bad"):
        for name in names:
            cell = found[f"{kind}_{name}"]
            settings = cell["settings"]
            said = (
                f"SSIM {mean(cell['ssim'])}, untuned {mean(cell['untuned']['psnr'])} dB; "
                f"{settings['variation']:g}, {settings['iterations']} iterations, "
                f"brightness {settings['brightness']:.2f}; gaps {cell['gap']:.0e}, untuned "
                f"{cell['untuned_gap']:.0e}, converged {cell['converged_gap']:.0e}"
            )
            key = f"convex_psnr_{kind}_{name}"
            row(key, mean(cell["psnr"]), paper.get(key), said)
    print(f"the mean picture of the training set: {mean(guess)} dB")
    for name in names:
        good, bad = (found[f"{kind}_{name}"]["psnr"] for kind in ("good", "bad"))
        print(f"{name}: right PSF over wrong {proven(difference(good, bad))}")
    for larger, smaller in pairwise(names):
        one, other = (found[f"good_{name}"]["psnr"] for name in (larger, smaller))
        print(f"{larger} over {smaller}, right PSF: {proven(difference(one, other))}")


def as_figures(found: dict[str, Values], names: list[str], guess: list[float]) -> dict[str, float]:
    """Figures by name."""
    values = {"convex_psnr_mean_picture": round(mean(guess).value, 2)}
    for name in names:
        for kind in ("good", "bad"):
            cell = found[f"{kind}_{name}"]
            values[f"convex_psnr_{kind}_{name}"] = round(mean(cell["psnr"]).value, 2)
            values[f"convex_ssim_{kind}_{name}"] = round(mean(cell["ssim"]).value, 3)
            untuned = mean(cell["untuned"]["psnr"])
            values[f"convex_untuned_psnr_{kind}_{name}"] = round(untuned.value, 2)
        good, bad = (found[f"{kind}_{name}"]["psnr"] for kind in ("good", "bad"))
        values[f"convex_gain_{name}"] = round(difference(good, bad).value, 2)
        values[f"convex_gain_least_{name}"] = round(difference(good, bad).least, 2)
    values["convex_gap"] = max(cell["converged_gap"] for cell in found.values())
    return values
