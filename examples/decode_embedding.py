"""Decode an embedding: the picture that a sealed embedding gives to a receiver.

python examples/decode_embedding.py FRAME KEYFILE [URL]

``veilcam-train frame BUNDLE FRAME`` writes the frame, which is public; ``veilcam receiver keygen
KEYFILE`` the key, which ``veilcam receiver add`` pairs with the camera.
"""

import sys

from veilcam_client import Camera, SceneDecoder

frame, key, *url = sys.argv[1:]
decoder = SceneDecoder(frame, key)
with Camera(*url) as camera:
    scene = decoder.decode(camera.capture())
shades = " .:-=+*#%@"
for row in scene.clip(0, 1):
    print("".join(shades[round(9 * float(value))] * 2 for value in row))
