"""Photograph a point source through a random mask on the simulated panel.

The PSF that comes of it is for the encoder ``fixed_measured``.

The panel is displaced, turned, of the wrong gamma and never quite dark; the photograph has shot
noise, a background and 12 bits; the background is then removed as from any photograph. No real
camera has been measured yet: what comes of this file is called measured for want of one.

    python -m benchmarks.optics.measured_psf data/measured-psf.npz
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from PIL import Image
from torch import Tensor

from veilcam_optics.apertures import measured_psf
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import Conditions, Imperfections
from veilcam_optics.camera.masks import quantise, random_mask
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.simulation.operator import LightOperator

PANEL = Conditions(
    bayer=True,  # each channel is a photograph of its own
    imperfections=Imperfections(
        shift_y=3e-5,
        shift_x=-2e-5,
        rotation=2e-3,
        distance_error=3e-5,
        gamma=1.1,
        contrast_floor=0.03,
    ),
)
"""What is wrong with it."""
OVERSAMPLING = 2.0
SENSOR_PIXELS = 8 / OVERSAMPLING
"""Sensor pixels along each side of a pixel of the photograph."""
BACKGROUND = 0.01
"""Light of a room that is nearly dark, over the brightest point."""
BITS = 12


def photograph(psf: Tensor, snr_db: float, generator: torch.Generator) -> Tensor:
    """Integers of 12 bits, (3, rows, columns), with background and shot noise."""
    exposed = psf / psf.max() + BACKGROUND
    noisy = torch.stack([shot_noise(channel[None], snr_db, generator)[0] for channel in exposed])
    top = 2**BITS - 1
    levels: Tensor = (noisy / noisy.max() * top).round().clamp(0, top)
    return levels


def main(
    out: Annotated[Path, typer.Argument(help="File to write, *.npz.")],
    *,
    snr_db: Annotated[float, typer.Option(help="Of the photograph [dB].")] = 30.0,
    seed: Annotated[int, typer.Option(help="Of mask and noise.")] = 1,
) -> None:
    """Write the PSF, its pitch and its distance."""
    torch.set_num_threads(1)
    camera, generator = Camera(), torch.Generator().manual_seed(seed)
    weights = quantise(random_mask(camera, generator), camera.panel)
    sampling = Sampling(method="grid", oversampling=OVERSAMPLING, dtype=torch.float32)
    light = LightOperator(Model(camera, Scene(), Embedding(), PANEL, sampling))
    with torch.no_grad():
        (psf,) = light.response(weights)
        levels = photograph(psf, snr_db, generator)
    with tempfile.TemporaryDirectory() as folder:
        # 8 bits are what Pillow writes of three channels; each is thus a photograph of its own.
        channels = []
        for number, channel in enumerate(levels):
            path = Path(folder) / f"{number}.png"
            Image.fromarray((channel.numpy() * 16).astype(np.uint16)).save(path)
            channels.append(measured_psf(path) * float(channel.sum() / levels.mean(0).sum()))
    brightness = float(psf.mean(0).sum())  # as a meter beside the camera would have it
    np.savez_compressed(
        out,
        psf=(torch.stack(channels) * brightness).float().numpy(),
        pitch=SENSOR_PIXELS * camera.sensor.pixel,
        distance=camera.distance,
    )
    typer.echo(f"wrote {out}, {out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    typer.run(main)
