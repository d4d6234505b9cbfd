"""Read a label: what the camera sees, and how sure it is.

python examples/read_label.py [URL]
"""

import sys

from veilcam_client import Camera

with Camera(*sys.argv[1:]) as camera:
    seen = camera.classify()
    print(f"label {seen.label}, confidence {seen.confidence:.2f}, epoch {seen.epoch}")
    for label, score in sorted(seen.scores.items(), key=lambda item: -item[1])[:3]:
        print(f"  {label}: {score:.3f}")
