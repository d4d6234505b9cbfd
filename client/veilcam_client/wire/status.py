"""The daemon at a glance, and what it tells of itself to who looks for a fault."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Literal

from pydantic import JsonValue

from veilcam_client.wire.base import API_VERSION, EXAMPLE_TIME, Answer, installed_version
from veilcam_client.wire.bundles import BundleInfo, example_bundle
from veilcam_client.wire.rotation import Rotation, example_rotation
from veilcam_client.wire.sealing import EXAMPLE_DEVICE, PairedReceiver, Release, example_receiver

State = Literal[
    "starting", "self-test", "ready", "off", "calibrating", "degraded", "safe", "replay", "stopping"
]
"""``off``: the panel is opaque and no capture is taken, because that is wanted now; ``safe``: the
same (or the panel's content is unknown), because something failed; ``replay``: there is no panel,
and captures come from a recording."""
Remedy = Literal[
    "wait",
    "adjust_light",
    "shield_light",
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
    """Name of the panel."""
    sensor: str
    """Name of the sensor."""
    simulated: bool
    """True: both are simulated."""
    key: str
    """Its public Ed25519 key, 64 hexadecimal digits: it signs envelopes."""


class Queue(Answer):
    """Captures admitted and not yet answered, and how many may be."""

    waiting: int
    """Captures that wait."""
    limit: int
    """Captures that may wait."""


class WallClock(Answer):
    """The clock of the daemon's machine, by which quiet hours go."""

    zone: str
    """Time zone, such as ``Europe/Berlin``."""
    synchronised: bool
    """True: the kernel calls it synchronised."""


class Status(Answer):
    """The daemon at a glance."""

    version: str
    """Version of the daemon."""
    api_version: int
    """Version of the API."""
    state: State
    """State of the camera."""
    detail: str | None = None
    """Why the state is not ``ready``."""
    remedy: Remedy | None = None
    """Remedy, where the state is ``degraded`` or ``safe``."""
    experiment: str | None = None
    """``wrong-classifier`` when labels are meaningless on purpose."""
    uptime_s: float
    """Time since the start [s]."""
    captures: int
    """Captures since the start that callers asked for, without those of the watch."""
    release: Release
    """Form in which embeddings leave."""
    raw_budget: int
    """Embeddings that may leave raw behind one mask, over its whole life."""
    receivers: tuple[PairedReceiver, ...]
    """To whom epochs are sealed, from the next one on."""
    device: Device
    """Panel, sensor and key."""
    bundle: BundleInfo
    """Bundle in use."""
    rotation: Rotation
    """Policy of mask changes, and the present mask."""
    queue: Queue
    """Captures that wait."""
    clock: WallClock | None = None
    """None: an older daemon's."""


class PastState(Answer):
    """A state that the daemon entered."""

    at: datetime
    """Time of the change."""
    state: State
    """State from then on."""
    detail: str | None
    """Reason, where it was not ``ready``."""
    remedy: Remedy | None = None
    """Remedy, where something failed."""


class PastFault(Answer):
    """Something that failed; ``code`` is that of the problem."""

    at: datetime
    """Time of the fault."""
    code: str
    """Code of the problem."""
    detail: str
    """Description of the fault."""
    remedy: Remedy = "wait"
    """Remedy."""


class Diagnostics(Answer):
    """Versions, settings, and what happened lately. No secret is in it."""

    versions: Mapping[str, str]
    """Versions of the interpreter, the system, and the main packages."""
    settings: Mapping[str, JsonValue]
    """Settings of the daemon; ``"given"`` stands for a path, an address or a label."""
    states: tuple[PastState, ...]
    """The last ones, the latest last."""
    faults: tuple[PastFault, ...]
    """The last ones, the latest last."""
    events: Mapping[str, int]
    """Number of events of each kind since the start."""
    fault_counts: Mapping[str, int]
    """Number of faults of each code since the start."""
    log_missed: int
    """Entries of the log that could not be written."""


class DoctorFinding(Answer):
    """Result of one check of the machine."""

    name: str
    """Name of the check."""
    outcome: Literal["ok", "bad", "skipped"]
    """``bad``: the daemon cannot serve as it should; ``skipped``: another must be well first."""
    found: str
    """Paths of the daemon stand there as their settings, ``$VEILCAM_...``."""
    remedy: str | None
    """Remedy, where it is not well."""


class DoctorFindings(Answer):
    """Every check that can be made while the daemon holds panel and camera."""

    findings: tuple[DoctorFinding, ...]
    """One for each check."""


EXAMPLE_CLOCK = WallClock(zone="Europe/Berlin", synchronised=True)


def example_status() -> Status:
    """For documents."""
    return Status(
        version=installed_version(),
        api_version=API_VERSION,
        state="ready",
        uptime_s=3600.0,
        captures=1200,
        release="sealed",
        raw_budget=0,
        receivers=(example_receiver(),),
        device=Device(display="ST7735R", sensor="IMX477", simulated=False, key=EXAMPLE_DEVICE),
        bundle=example_bundle(),
        rotation=example_rotation(),
        queue=Queue(waiting=0, limit=8),
        clock=EXAMPLE_CLOCK,
    )


def examples() -> tuple[Answer, ...]:
    """Return examples for documents."""
    return (
        example_status(),
        DoctorFindings(
            findings=(
                DoctorFinding(
                    name="disk",
                    outcome="bad",
                    found="12 MiB free",
                    remedy="make room: without it no change is made",
                ),
            )
        ),
        Diagnostics(
            versions={"veilcam": installed_version(), "python": "3.11.9"},
            settings={"device": "pi", "callers": 16, "bundle": "given"},
            states=(PastState(at=EXAMPLE_TIME, state="ready", detail=None),),
            faults=(
                PastFault(
                    at=EXAMPLE_TIME,
                    code="sensor_failed",
                    detail="no frame in 5 s",
                    remedy="check_camera_cable",
                ),
            ),
            events={"capture": 1200, "mask": 120},
            fault_counts={"sensor_failed": 1},
            log_missed=0,
        ),
    )
