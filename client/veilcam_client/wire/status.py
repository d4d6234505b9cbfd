"""The daemon at a glance."""

from __future__ import annotations

from importlib.metadata import version
from typing import Literal

from veilcam_client.wire.base import API_VERSION, Answer
from veilcam_client.wire.bundles import EXAMPLE_BUNDLE, BundleInfo
from veilcam_client.wire.captures import Release
from veilcam_client.wire.rotation import EXAMPLE_ROTATION, Rotation
from veilcam_client.wire.sealing import EXAMPLE_DEVICE, EXAMPLE_RECEIVER, PairedReceiver

State = Literal[
    "starting", "self-test", "ready", "calibrating", "degraded", "safe", "replay", "stopping"
]
"""``safe``: the panel is opaque (or its content unknown) and no capture is taken; ``replay``: there
is no panel, and captures come from a recording."""
Remedy = Literal[
    "wait",
    "adjust_light",
    "check_panel_wiring",
    "check_camera_cable",
    "check_disk",
    "run_doctor",
    "install_bundle",
    "restart",
    "report_defect",
]
"""What ends ``degraded`` and ``safe``, or a fault: see docs/api.md. All are tried again without it.
"""


class Device(Answer):
    """The panel and the sensor."""

    display: str
    sensor: str
    simulated: bool
    key: str
    """Its public Ed25519 key, 64 hexadecimal digits: it signs envelopes."""


class Queue(Answer):
    """Captures admitted and not yet answered, and how many may be."""

    waiting: int
    limit: int


class Status(Answer):
    """The daemon at a glance."""

    version: str
    api_version: int
    state: State
    detail: str | None = None
    """Why the state is not ``ready``."""
    remedy: Remedy | None = None
    """What helps, where the state is ``degraded`` or ``safe``."""
    experiment: str | None = None
    """``wrong-classifier`` when labels are meaningless on purpose."""
    uptime_s: float
    captures: int
    release: Release
    """In which form embeddings leave."""
    raw_budget: int
    """Embeddings that may leave raw behind one mask, over its whole life."""
    receivers: tuple[PairedReceiver, ...]
    """To whom epochs are sealed, from the next one on."""
    device: Device
    bundle: BundleInfo
    rotation: Rotation
    queue: Queue


EXAMPLES = (
    Status(
        version=version("veilcam"),
        api_version=API_VERSION,
        state="ready",
        uptime_s=3600.0,
        captures=1200,
        release="sealed",
        raw_budget=0,
        receivers=(EXAMPLE_RECEIVER,),
        device=Device(display="ST7735R", sensor="IMX477", simulated=False, key=EXAMPLE_DEVICE),
        bundle=EXAMPLE_BUNDLE,
        rotation=EXAMPLE_ROTATION,
        queue=Queue(waiting=0, limit=8),
    ),
)
