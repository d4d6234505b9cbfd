"""What do masks that are no panel make of a scene: a printed pattern, and a diffuser?

python examples/gallery/free_form.py OUT.png
"""

import sys
from dataclasses import replace

import torch
from matplotlib.figure import Figure

from veilcam_optics import Camera, Embedding, Scene, Sensor
from veilcam_optics.apertures import diffuser_height, mls_cells, phase_plate
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.transfer.free_form import FreeFormMask, free_form_transfer

PITCH = 10e-6
camera = replace(
    Camera(), sensor=Sensor(rows=100, columns=100, pixel=6e-6), distance=4e-3
).monochrome(550e-9)
scene, embedding = Scene(16, 16, height=0.04), Embedding(12, 12)

cells = mls_cells(order=5, repeats=2)
rows, columns = cells.shape
grid = Grid.square(rows, columns, PITCH)
relief = diffuser_height(
    grid, roughness=1e-6, correlation=60e-6, generator=torch.Generator().manual_seed(0)
)
diffuser = phase_plate(relief, camera.wavelengths[1])
masks = {"print": cells, "diffuser": phase_plate(relief, camera.wavelengths[1])}

ring = torch.zeros(scene.shape, dtype=torch.float64)
ring[3:13, 3:13] = 1
ring[6:10, 6:10] = 0

figure = Figure(figsize=(10, 2.4), layout="constrained")
shown = [("scene", ring, "gray")]
for name, values in masks.items():
    transfer = free_form_transfer(camera, scene, embedding, FreeFormMask(values, PITCH))
    singular = torch.linalg.svdvals(transfer)
    embedded = (ring.flatten() @ transfer).reshape(embedding.shape)
    layout = (values.angle(), "twilight") if values.is_complex() else (values, "gray")
    shown += [(name, *layout), ("its embedding", embedded, "gray")]
    apart = int((singular > 1e-2 * singular[0]).sum())
    print(f"{name}: light {float(transfer.sum() / embedding.size):.3f}, told apart {apart}")
for axes, (title, values, colours) in zip(figure.subplots(1, len(shown)), shown, strict=True):
    axes.imshow(values.numpy(), cmap=colours)
    axes.set_title(title)
    axes.axis("off")
figure.savefig(sys.argv[1], dpi=60)
