"""Compare methods: error of one mask's transfer against the CPU time it takes, each checked.

python examples/gallery/compare_methods.py OUT.png
"""

import sys
import time
from dataclasses import replace

import torch
from matplotlib.figure import Figure

from veilcam_optics import Camera, Embedding, Reach, Scene, Window, plan, random_mask
from veilcam_optics.simulation.check import check
from veilcam_optics.simulation.operator import LightOperator

camera, scene = Camera(window=Window(18, 8)), Scene(8, 8, height=0.05)
weights = random_mask(camera, torch.Generator().manual_seed(1))
chosen = plan(camera, scene, Embedding(12, 16), 3e-3)
sampling = chosen.model.sampling
ways = {
    "shadows": replace(sampling, diffraction=False),
    "no interference": replace(sampling, reach=Reach(0, 0), step=1e-6),
    "next row": replace(sampling, reach=Reach(3, 0), step=1e-6),
    "next row and column": replace(sampling, reach=Reach(3, 1), step=1e-6),
    "the plan": sampling,
}
figure = Figure(figsize=(6.5, 4), layout="constrained")
axes = figure.subplots()
points = torch.eye(64).reshape(-1, 8, 8)
for name, way in ways.items():
    operator = LightOperator(replace(chosen.model, sampling=way))
    with torch.no_grad():
        operator.embed(points, weights)
        start = time.process_time()
        operator.embed(points, weights)
    milliseconds = 1e3 * (time.process_time() - start)
    found = check(operator, chosen.asked, weights, entries=24)
    print(f"{name}: {found}, {milliseconds:.1f} ms")
    span = [[found.error - found.low], [found.high - found.error]]
    axes.errorbar(milliseconds, found.error, span, fmt="o", capsize=3, label=name)
axes.set(
    xscale="log", yscale="log", xlabel="CPU time of 64 embeddings [ms]", ylabel="relative L2 error"
)
axes.grid(alpha=0.3)
axes.legend()
figure.savefig(sys.argv[1], dpi=70)
