"""A stored mask that is broken by one known picture, and a fresh one that is not.

python examples/gallery/break_mask.py OUT.png
"""

import sys

import torch
from matplotlib.figure import Figure

from veilcam_optics import Camera, Embedding, Scene, TransferOperator, random_mask
from veilcam_optics.decoding import SceneDecoding, fit_statistics
from veilcam_optics.sensor.noise import shot_noise
from veilcam_training.attacks.mask_recovery import KnownPictures, Search, estimates, recover_mask
from veilcam_training.data.sample import shipped_digits

generator = torch.Generator().manual_seed(4)
camera, scene, embedding = Camera(), Scene(), Embedding(18, 24)
operator = TransferOperator(camera, scene, embedding)
digits = shipped_digits().scenes(torch.arange(200))
known, hidden = digits[:1], digits[1:5]
decoding = SceneDecoding(operator, fit_statistics([digits[5:]], rank=128))

# The attacker saw one picture and what left of it; what they want are the others.
stored, fresh = random_mask(camera, generator), random_mask(camera, generator)
seen = shot_noise(operator.embed(known, stored).flatten(1), 40.0, generator)
found = recover_mask(
    KnownPictures(decoding, known, seen),
    camera.mask_shape,
    search=Search(steps=450, starts=1),
    generator=generator,
).weights

rows = {}
for name, mask in (("same mask", stored), ("fresh mask", fresh)):
    released = shot_noise(operator.embed(hidden, mask).flatten(1), 40.0, generator)
    rows[name] = estimates(decoding, found, released).reshape(hidden.shape)
    alike = torch.corrcoef(torch.stack([hidden.flatten(), rows[name].flatten()]))[0, 1]
    print(f"{name}: correlation {alike:.2f} with the scenes")

figure = Figure(figsize=(7, 5.6), layout="constrained")
figure.suptitle("by a mask that was found from one known picture")
shown = {"scenes": hidden, **rows}
for axes_row, (name, pictures) in zip(
    figure.subplots(len(shown), len(hidden)), shown.items(), strict=True
):
    for axes, picture in zip(axes_row, pictures, strict=True):
        axes.imshow(picture.numpy(), cmap="gray", vmin=0, vmax=1)
        axes.set(xticks=[], yticks=[])
    axes_row[0].set_ylabel(name)
figure.savefig(sys.argv[1], dpi=65)
