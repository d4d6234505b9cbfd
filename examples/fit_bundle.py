"""Fit a bundle: two masks learned with a linear classifier each, in one file for the daemon.

python examples/fit_bundle.py DATA OUT.veilcam    # DATA holds MNIST's files
"""

import sys
from pathlib import Path

from veilcam_optics import Camera
from veilcam_training.bundle import write_bundle
from veilcam_training.config.settings import FitSettings
from veilcam_training.data import open_source
from veilcam_training.experiments.keyring import fit_keyring

data, out = map(Path, sys.argv[1:])
settings = FitSettings(encoder="learned", embedding="6x8", epochs=2, batch=64)
bundle = fit_keyring(settings, 2, open_source("mnist", data), Camera())
write_bundle(out, bundle)
assert bundle.accuracy is not None
print(f"{len(bundle.pairs)} pairs, accuracy {bundle.accuracy.value:.3f}: {out}")
