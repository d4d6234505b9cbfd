"""What does dead space cost: light, and the error of a simulation that leaves it out.

python examples/gallery/dead_space.py OUT.png
"""

import sys
from dataclasses import replace

import torch
from matplotlib.figure import Figure

from veilcam_optics import Embedding, Scene, plan, random_mask
from veilcam_optics.camera.presets import preset

slm = preset("slm")
weights = random_mask(slm, torch.Generator().manual_seed(1))
shares, light, ignored = (0.2, 0.4, 0.6, 0.8, 0.95), [], []
for share in shares:
    camera = replace(slm, panel=slm.panel.with_fill_factor(share))
    chosen = plan(camera, Scene(4, 4, height=0.05), Embedding(6, 8), 2e-2, method="transfer")
    with torch.no_grad():
        light.append(float(chosen.transfer(weights).mean()))
    [dead] = [found for found in chosen.assessments if found.name == "dead space"]
    ignored.append(dead.error)
    print(f"{100 * share:.0f} % open: light {light[-1]:.3g}, error if ignored {dead.error:.2g}")
figure = Figure(figsize=(8, 3.4), layout="constrained")
left, right = figure.subplots(1, 2)
percent = [100 * share for share in shares]
left.plot(percent, light, "o-")
left.set(xlabel="open share of the panel [%]", ylabel="light on the sensor", ylim=(0, None))
right.semilogy(percent, ignored, "o-")
right.set(xlabel="open share of the panel [%]", ylabel="relative L2 error if ignored")
figure.savefig(sys.argv[1], dpi=70)
