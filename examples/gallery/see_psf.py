"""See a point spread function: what one mask makes of one point of light, with each camera.

python examples/gallery/see_psf.py OUT.png
"""

import sys

import torch
from matplotlib.figure import Figure

from veilcam_optics import Embedding, Scene, plan, random_mask
from veilcam_optics.camera.presets import PRESETS

figure = Figure(figsize=(9, 5), layout="constrained")
axes = figure.subplots(2, len(PRESETS))
for (name, found), (above, below) in zip(PRESETS.items(), axes.T, strict=True):
    camera = found.camera
    weights = random_mask(camera, torch.Generator().manual_seed(1))
    if camera.panel.levels == 2:
        weights = weights.round()
    # One scene point: the point spread function asks for no more.
    chosen = plan(camera, Scene(1, 1), Embedding(6, 8), 5e-2)
    psf = chosen.psf(weights, rows=90)
    above.imshow(weights.numpy(), cmap="gray", vmin=0, vmax=1)
    above.set_title(f"{name}: mask, {camera.mask_shape[0]} x {camera.mask_shape[1]}")
    colours = psf.permute(1, 2, 0) / psf.quantile(0.999)
    side = 500 * camera.sensor.width, 500 * camera.sensor.height
    below.imshow(colours.clamp(0, 1).numpy(), extent=(-side[0], side[0], side[1], -side[1]))
    below.set_xlabel(f"mm on the sensor, {1e3 * camera.distance:g} mm behind")
    print(f"{name}: brightest {float(psf.max()):.3g}, mean {float(psf.mean()):.3g}")
figure.savefig(sys.argv[1], dpi=45)
