"""Open a sealed embedding: pair a receiver with the camera, and read what it alone can read.

python examples/sealed_embedding.py KEYFILE [URL]    # as 'veilcam receiver keygen' made it
"""

import sys

import numpy as np

from veilcam_client import Camera
from veilcam_client.keys.receivers import ReceiverKey

file, *url = sys.argv[1:]
key = ReceiverKey.read(file)
with Camera(*url) as camera:
    if key.public.id not in {each.id for each in camera.receivers.list().receivers}:
        camera.receivers.add("an example", key.public)
        camera.rotation.advance()  # what is prepared for the next mask is sealed to it
    device = camera.receivers.list().device
with Camera(*url, key=key, device=device) as camera:
    taken = camera.capture()
    print(f"epoch {taken.epoch}, number {taken.number}: mean {np.asarray(taken).mean():.4g}")
