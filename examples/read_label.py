"""Read a label: what the camera sees, and the scores of its labels.

python examples/read_label.py [URL]
"""

import sys

from veilcam_client import Camera

with Camera(*sys.argv[1:]) as camera:
    seen = camera.classify()
    print(f"label {seen.label}, epoch {seen.epoch}")
    # Scores are a scope of their own; without it there is the label alone.
    for label, score in sorted((seen.scores or {}).items(), key=lambda item: -item[1])[:3]:
        print(f"  {label}: {score:.3f}")
