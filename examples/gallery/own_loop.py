"""The camera in one's own loop: as A and its adjoint for SciPy, and as a module of torch.

python examples/gallery/own_loop.py OUT.png
"""

import sys

import numpy as np
import torch
from matplotlib.figure import Figure
from scipy.sparse.linalg import LinearOperator, lsqr

from veilcam_optics import Camera, Embedding, Scene, plan, random_mask

camera, scene, embedding = Camera(), Scene(12, 12, height=0.05), Embedding(18, 24)
weights = random_mask(camera, torch.Generator().manual_seed(1))
chosen = plan(camera, scene, embedding, 2e-2, method="transfer")

# A maps a scene to its embedding, its adjoint maps back: all that an inverse problem needs.
transfer = chosen.transfer(weights).double().numpy()
A = LinearOperator(
    (embedding.size, scene.rows * scene.columns),
    matvec=lambda seen: seen.ravel() @ transfer,
    rmatvec=lambda measured: transfer @ measured.ravel(),
)
truth = np.zeros((12, 12))
truth[2:10, 3:5] = truth[8:10, 3:10] = 1
exact = A.matvec(truth.ravel())
noise = np.random.default_rng(0).standard_normal(exact.size)
measured = exact + 1e-3 * np.linalg.norm(exact) / np.sqrt(exact.size) * noise
damp = 1e-3 * float(np.linalg.norm(transfer, 2))
recovered = lsqr(A, measured, damp=damp, iter_lim=300)[0].reshape(12, 12)
off = np.linalg.norm(recovered - truth) / np.linalg.norm(truth)
print(f"lsqr: scene recovered to {off:.2g}")


class Reader(torch.nn.Module):
    """Mask, optics and a classifier, fitted together."""

    def __init__(self) -> None:
        super().__init__()
        self.mask = torch.nn.Parameter(weights.clone())
        self.optics = chosen.operator
        self.head = torch.nn.Linear(embedding.size, 2)

    def forward(self, scenes: torch.Tensor) -> torch.Tensor:
        """Scores of scenes."""
        seen = self.optics.embed(scenes, self.mask.clamp(0, 1)).flatten(1)
        scores: torch.Tensor = self.head((seen - seen.mean(0)) / seen.std(0))
        return scores


generator = torch.Generator().manual_seed(3)
labels = torch.arange(64) % 2
bars = torch.rand(64, 12, 12, generator=generator) * 0.5
for scene_, label in zip(bars, labels.tolist(), strict=True):
    at = int(torch.randint(12, (), generator=generator))
    (scene_ if label else scene_.T)[at] = 1  # a bar across or down
torch.manual_seed(0)
reader, losses = Reader(), []
adam = torch.optim.Adam(reader.parameters(), lr=2e-2)
for _ in range(100):
    loss = torch.nn.functional.cross_entropy(reader(bars), labels)
    adam.zero_grad()
    torch.autograd.backward(loss)
    adam.step()
    losses.append(float(loss.detach()))
print(f"own loop: loss from {losses[0]:.2g} to {losses[-1]:.2g}")

figure = Figure(figsize=(10, 2.8), layout="constrained")
left, middle, right, curve = figure.subplots(1, 4)
pictures = (truth, measured.reshape(18, 24), recovered)
titles = ("scene", "embedding", "by lsqr")
for axes, picture, title in zip((left, middle, right), pictures, titles, strict=True):
    axes.imshow(picture, cmap="gray")
    axes.set_title(title)
curve.semilogy(losses)
curve.set(title="mask and classifier", xlabel="step", ylabel="loss")
figure.savefig(sys.argv[1], dpi=65)
