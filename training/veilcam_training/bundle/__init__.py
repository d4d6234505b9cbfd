"""Bundles: what training hands to a camera. This is all of training that the server imports."""

from veilcam_training.bundle.archive import add_card, read_bundle, sign_bundle, write_bundle
from veilcam_training.bundle.card import CardRow, Finding, Outcome, PrivacyCard
from veilcam_training.bundle.errors import BundleError
from veilcam_training.bundle.fresh import Fresh, classifier_inputs
from veilcam_training.bundle.hiding import Hiding, sentences, shows
from veilcam_training.bundle.layers import LayerRecord
from veilcam_training.bundle.model import Accuracy, Bundle, LightPlan, Pair, TransferError
from veilcam_training.bundle.network import Network
from veilcam_training.bundle.signature import OwnerKey, read_key, write_key

__all__ = [
    "Accuracy",
    "Bundle",
    "BundleError",
    "CardRow",
    "Finding",
    "Fresh",
    "Hiding",
    "LayerRecord",
    "LightPlan",
    "Network",
    "Outcome",
    "OwnerKey",
    "Pair",
    "PrivacyCard",
    "TransferError",
    "add_card",
    "classifier_inputs",
    "read_bundle",
    "read_key",
    "sentences",
    "shows",
    "sign_bundle",
    "write_bundle",
    "write_key",
]
