"""From a bundle and the settings to where masks come from, and how embeddings leave."""

from __future__ import annotations

from veilcam_client.models import EveryCaptures, Release, RotationOff, RotationPolicy
from veilcam_optics.decoding import AS_DRAWN, Calibration
from veilcam_server.errors import StartError
from veilcam_server.fresh import FreshSource
from veilcam_server.mask_secret import find_secret
from veilcam_server.masks import MaskSource
from veilcam_server.pairs import load_pairs
from veilcam_server.settings import Settings
from veilcam_training.bundle import Bundle


def open_source(
    settings: Settings, bundle: Bundle, calibration: Calibration = AS_DRAWN
) -> MaskSource:
    """Return what gives masks and their readers.

    Args:
        settings: checked.
        bundle: to serve.
        calibration: what decoders are prepared for. Stored pairs have none: what they read was
            learned for the camera as drawn.

    Raises:
        StartError: the bundle cannot be served as it is, or the secret is missing.
    """
    if bundle.mode == "fresh":
        return FreshSource(
            bundle,
            find_secret(settings.mask_secret),
            device=settings.device_label,
            form=release_form(settings, bundle),
            wrong_decoder=settings.wrong_classifier,
            calibration=calibration,
        )
    for option, value in (
        ("--mask-secret", settings.mask_secret),
        ("--device-label", settings.device_label),
    ):
        if value is not None:
            raise StartError(f"{option} is for fresh masks: this bundle holds pairs")
    return load_pairs(bundle, wrong_classifier=settings.wrong_classifier)


def release_form(settings: Settings, bundle: Bundle) -> Release:
    """Return the form in which embeddings leave.

    Unless it is said, embeddings of fresh masks leave white, of the forms that let
    anything out the one that tells least; those of stored pairs stay inside, but for a simulated
    camera, which sees nobody.

    Raises:
        StartError: a form that needs scene statistics, and the bundle has none.
    """
    if settings.release is not None:
        if bundle.mode == "pairs" and settings.release in ("flat", "white"):
            raise StartError(
                f"--release {settings.release} needs the scene statistics of a bundle of mode "
                "'fresh': use none or raw"
            )
        return settings.release
    if bundle.mode == "fresh":
        return "white"
    return "raw" if settings.device == "simulated" else "none"


def rotation_policy(settings: Settings, bundle: Bundle) -> RotationPolicy:
    """Return when masks change; unless it is said, fresh ones after every capture, pairs never."""
    if settings.rotation is not None:
        return settings.rotation
    return EveryCaptures(captures=1) if bundle.mode == "fresh" else RotationOff()
