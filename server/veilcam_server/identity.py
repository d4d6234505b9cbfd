"""What a daemon is, for its status."""

from __future__ import annotations

from dataclasses import dataclass

from veilcam_client.wire.calibration import SignedCalibration
from veilcam_client.wire.captures import BundleInfo, Device
from veilcam_training.bundle import Bundle


@dataclass(frozen=True, slots=True)
class Identity:
    """What the daemon tells of itself; of all this only the bundle changes while it runs."""

    device: Device
    bundle: BundleInfo
    experiment: str | None = None
    calibration: SignedCalibration | None = None


def bundle_info(bundle: Bundle) -> BundleInfo:
    """What may be told of a bundle."""
    return BundleInfo(
        digest=bundle.digest,
        task=bundle.task,
        mode=bundle.mode,
        labels=bundle.labels,
        embedding_shape=bundle.embedding.shape,
        pairs=len(bundle.pairs),
    )
