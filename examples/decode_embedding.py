"""Decode an embedding: the picture that a released embedding gives to who has the secret.

python examples/decode_embedding.py FRAME SECRET DEVICE [URL]

``veilcam-train frame BUNDLE FRAME`` writes the frame, which is public.
"""

import sys

from veilcam_client import Camera, SceneDecoder

frame, secret, device, *url = sys.argv[1:]
decoder = SceneDecoder(frame, secret, device=device)
with Camera(*url) as camera:
    scene = decoder.decode(camera.capture())
shades = " .:-=+*#%@"
for row in scene.clip(0, 1):
    print("".join(shades[round(9 * float(value))] * 2 for value in row))
