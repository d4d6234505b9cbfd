"""Rotate masks: a mask for every capture, then the policy from before.

python examples/rotate_masks.py [URL]
"""

import sys

from veilcam_client import Camera
from veilcam_client.models import EveryCaptures

with Camera(*sys.argv[1:]) as camera:
    before = camera.rotation.get().policy
    camera.rotation.set(EveryCaptures(captures=1))
    for _ in range(3):
        seen = camera.classify()
        print(f"epoch {seen.epoch}: {seen.label}")
    camera.rotation.set(before)
    print(f"back to {camera.rotation.get().policy.mode}")
