"""Bundles: what training hands to a camera. This is all of training that the server imports."""

from veilcam_training.bundle.archive import read_bundle, write_bundle
from veilcam_training.bundle.classifier import build_classifier, build_untrained
from veilcam_training.bundle.errors import BundleError
from veilcam_training.bundle.fresh import Feature, Fresh, classifier_inputs
from veilcam_training.bundle.layers import LayerRecord
from veilcam_training.bundle.model import Accuracy, Bundle, Pair

__all__ = [
    "Accuracy",
    "Bundle",
    "BundleError",
    "Feature",
    "Fresh",
    "LayerRecord",
    "Pair",
    "build_classifier",
    "build_untrained",
    "classifier_inputs",
    "read_bundle",
    "write_bundle",
]
