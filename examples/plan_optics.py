"""Plan the optics: which effects matter for an error of 1 %, and an embedding by that plan.

python examples/plan_optics.py
"""

import torch

from veilcam_optics import Camera, Conditions, Embedding, Imperfections, Scene, plan, random_mask

camera, scene = Camera(), Scene()
conditions = Conditions(levels=64, imperfections=Imperfections(gamma=2.2))
chosen = plan(camera, scene, Embedding(12, 16), 1e-2, conditions)
print(chosen.explain())
weights = random_mask(camera, torch.Generator().manual_seed(1))
embedding = chosen.embed(torch.ones(1, *scene.shape), weights)
print(f"a white scene: {tuple(embedding.shape)}, mean {float(embedding.mean()):.3g}")
