"""Design a mask in 30 lines: shapes, read with an embedding of 3 x 4 values, are told apart.

python examples/gallery/design_mask.py OUT.png
"""

import sys

import torch
from matplotlib.figure import Figure

from veilcam_optics import Camera, Embedding, Scene, plan, quantise, random_mask

camera, scene = Camera(), Scene(8, 8, height=0.06)
shapes = (torch.rand(10, 8, 8, generator=torch.Generator().manual_seed(2)) > 0.5).float()
optics = plan(camera, scene, Embedding(3, 4), 3e-2).operator  # an nn.Module
weights = random_mask(camera, torch.Generator().manual_seed(1)).requires_grad_()
start, losses = weights.detach().clone(), []


def distances(mask: torch.Tensor) -> torch.Tensor:
    """Between the embeddings of all pairs of shapes, against their size."""
    seen = optics.embed(shapes, quantise(mask, camera.panel)).flatten(1)
    apart: torch.Tensor = torch.pdist(seen) / seen.norm(dim=1).mean()
    return apart


adam = torch.optim.Adam([weights], lr=0.03)
for _ in range(150):
    adam.zero_grad()
    loss = -distances(weights).sort().values[:5].mean()  # the closest shapes count
    torch.autograd.backward(loss)
    adam.step()
    weights.data.clamp_(0, 1)
    losses.append(-float(loss.detach()))
print(
    f"closest shapes: {float(distances(start).min()):.3f} of their size at first, "
    f"{float(distances(weights.detach()).min()):.3f} at last"
)
figure = Figure(figsize=(8, 3.6), layout="constrained")
first, last, curve = figure.subplots(1, 3, width_ratios=(1, 1, 2))
for axes, mask, title in ((first, start, "at first"), (last, weights.detach(), "designed")):
    axes.imshow(mask.numpy(), cmap="gray", vmin=0, vmax=1, aspect="auto")
    axes.set_title(title)
curve.plot(losses)
curve.set(xlabel="step", ylabel="distance of the closest shapes")
figure.savefig(sys.argv[1], dpi=70)
