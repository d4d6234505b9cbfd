"""Choose a panel: how many numbers of a scene come through, by the singular values of T.

python examples/gallery/choose_panel.py OUT.png
"""

import sys

import torch
from matplotlib.figure import Figure

from veilcam_optics import Embedding, Scene, plan, random_mask
from veilcam_optics.camera.presets import PRESETS

NOISE = 1e-3
"""Of an embedding, against the largest singular value."""

figure = Figure(figsize=(6.5, 4), layout="constrained")
axes = figure.subplots()
for name, found in PRESETS.items():
    camera = found.camera
    weights = random_mask(camera, torch.Generator().manual_seed(1))
    if camera.panel.levels == 2:
        weights = weights.round()
    chosen = plan(camera, Scene(10, 10), Embedding(9, 12), 5e-2, method="transfer")
    with torch.no_grad():
        values = torch.linalg.svdvals(chosen.transfer(weights).double())
    values = values / values[0]
    above = int((values > NOISE).sum())
    print(f"{name}: {above} of {len(values)} above the noise, plan predicted {chosen.error:.1e}")
    axes.semilogy(values, label=f"{name}: {above} above the noise")
axes.axhline(NOISE, color="gray", linestyle="--", label=f"noise of {NOISE:g}")
axes.set(xlabel="singular value of the transfer", ylabel="against the largest", ylim=(1e-7, 2))
axes.legend()
figure.savefig(sys.argv[1], dpi=70)
