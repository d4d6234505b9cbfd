"""Answers in words, for a terminal."""

from json import dumps

import numpy as np
from pydantic import ValidationError

from veilcam_client.wire.bundles import BundleInfo, InstalledBundle
from veilcam_client.wire.calibration import CalibrationRecord, CalibrationRun, Quantity
from veilcam_client.wire.captures import Capture, Classification, SealedEmbedding
from veilcam_client.wire.events import (
    Believed,
    BundleChanged,
    CalibrationChanged,
    CaptureTaken,
    Classified,
    Event,
    Fault,
    Gap,
    Gone,
    MaskChanged,
    RotationChanged,
    Seen,
    StateChanged,
    WatchChanged,
)
from veilcam_client.wire.lease import Lease
from veilcam_client.wire.rotation import (
    EverySeconds,
    Preparation,
    Rotation,
    RotationOff,
    RotationPolicy,
)
from veilcam_client.wire.sealing import PairedReceiver
from veilcam_client.wire.status import Diagnostics, Remedy, Status, WallClock
from veilcam_client.wire.watch import Activity, Watching, WatchOff, WatchPolicy

_ROWS = (
    ("settling", "settling_s", 1e3, "ms"),
    ("black level", "black_level", 1.0, ""),
    ("gain", "gain", 1.0, ""),
    ("full scale", "full_scale", 1.0, ""),
    ("gamma", "gamma", 1.0, ""),
    ("contrast floor", "contrast_floor", 1.0, ""),
    ("dead lines pass", "dead_transmittance", 1.0, ""),
    ("shift along y", "shift_y_m", 1e6, "um"),
    ("shift along x", "shift_x_m", 1e6, "um"),
    ("rotation", "rotation_rad", 1e3, "mrad"),
    ("distance error", "distance_error_m", 1e6, "um"),
    ("stray light", "stray_light", 1e2, "%"),
)
"""Name, field of the record, factor and unit."""


def table(record: CalibrationRecord) -> list[tuple[str, ...]]:
    """All measured values, one row each; what dead lines pass only where there are any."""
    dead = record.dead_rows or record.dead_columns
    return [
        _row(name, getattr(record, field), factor, unit)
        for name, field, factor, unit in _ROWS
        if dead or field != "dead_transmittance"
    ]


def record_in_words(record: CalibrationRecord) -> str:
    """All measured values as a table, dead lines, and how well it fits."""
    rows = [("", "value", "uncertainty", "residual"), *table(record)]
    lines = [f"{name:<20}{value:>10}{spread:>13}{rest:>10}" for name, value, spread, rest in rows]
    for name, dead in (("rows", record.dead_rows), ("columns", record.dead_columns)):
        if dead:
            lines.append(f"dead {name}: {', '.join(map(str, dead))}")
    unseen = "measurements of the lamp behind patterns that no fit has seen are off by"
    lines.append(f"{unseen} {100 * record.psf_residual:.2g} %")
    lines.append(f"the light drifted by {100 * record.drift:.2g} %")
    return "\n".join(lines)


def run_in_words(run: CalibrationRun) -> str:
    """Return the progress of a calibration, in one line."""
    if run.stage in ("waiting", "failed"):
        return f"{run.stage}  {run.instruction or run.detail}"
    scene = f" of {run.scene}" if run.scene else ""
    return f"{run.stage}  {run.exposures} of {run.total} exposures{scene}"


def _row(name: str, quantity: Quantity, factor: float, unit: str) -> tuple[str, ...]:
    """Name, value, uncertainty and residual as a person reads them."""
    return (
        f"{name} [{unit}]" if unit else name,
        f"{factor * quantity.value:.4g}",
        f"{factor * quantity.uncertainty:.2g}",
        f"{100 * quantity.residual:.2g} %",
    )


def refusal(error: ValidationError) -> str:
    """Name the option at fault, or what does not fit together."""
    item = error.errors()[0]
    message = item["msg"].removeprefix("Input ").removeprefix("Value error, ")
    if not item["loc"]:
        return message
    name = str(item["loc"][0])
    option = f"--every-{name}" if name in ("seconds", "captures") else f"--{name}"
    return f"{option} {item['input']}: {message}"


def policy_in_words(policy: RotationPolicy) -> str:
    """Return the policy of mask changes in words."""
    if isinstance(policy, RotationOff):
        return "off"
    if isinstance(policy, EverySeconds):
        less = f", up to {policy.jitter:g} s less" if policy.jitter else ""
        often = f"every {policy.seconds:g} s{less}"
    else:
        often = f"every {policy.captures} captures"
    return f"{often}, or {policy.reuse} more when late" if policy.reuse else often


def masks_in_words(bundle: BundleInfo) -> str:
    """Return the kind of masks in words."""
    return "fresh masks" if bundle.mode == "fresh" else f"{bundle.pairs} masks"


def _next_in_words(preparation: Preparation) -> str:
    ready = "ready" if preparation.ready else "not ready"
    if not preparation.late:
        return ready
    return f"{ready}; late {preparation.late} times, {preparation.reused} captures reused a mask"


def replay_in_words(answer: Capture | Classification) -> str:
    """Say that a capture comes from a recording, and its time; empty for a new capture."""
    if answer.replay is None:
        return ""
    return f"  replay of {answer.taken_at:%Y-%m-%d %H:%M:%S}"


def status_in_words(status: Status) -> str:
    """Return the camera and its state in words."""
    shape = " x ".join(str(count) for count in status.bundle.embedding_shape)
    masks = masks_in_words(status.bundle)
    limit = f", {status.raw_budget} a mask at most" if status.release == "raw" else ""
    lines = [f"state     {status.state}{f' ({status.detail})' if status.detail else ''}"]
    if status.remedy:
        lines.append(f"remedy    {status.remedy}")
    if status.experiment:
        lines.append(f"          experiment: {status.experiment}, labels mean nothing")
    lines += [
        f"device    {status.device.display}, {status.device.sensor}",
        f"key       {status.device.key}",
        *([] if status.clock is None else [_clock_in_words(status.clock)]),
        f"task      {status.bundle.task}, {shape}, {masks}",
        rotation_in_words(status.rotation),
        f"next      {_next_in_words(status.rotation.preparation)}",
        f"release   {status.release}{limit}",
        *(f"receiver  {receiver_in_words(receiver)}" for receiver in status.receivers),
        f"captures  {status.captures} asked for in {status.uptime_s:.0f} s",
        f"version   {status.version}",
    ]
    return "\n".join(lines)


def receiver_in_words(receiver: PairedReceiver) -> str:
    """Return a receiver, in one line."""
    return f"{receiver.id[:16]}  since {receiver.added_at:%Y-%m-%d}  {receiver.label}"


def rotation_in_words(rotation: Rotation) -> str:
    """Return the policy of mask changes and the present epoch, in two lines."""
    epoch = "none: no mask is shown"
    if rotation.epoch is not None:
        epoch = f"{rotation.epoch}, {rotation.captures} captures"
    return f"rotation  {policy_in_words(rotation.policy)}\nepoch     {epoch}"


def lease_in_words(lease: Lease) -> str:
    """Return the holder of the camera, and the remaining time."""
    if not lease.held or lease.expires_in_s is None:
        return "nobody holds the camera"
    return f"held by {lease.owner!r} for another {lease.expires_in_s:.0f} s"


def capture_in_words(capture: Capture) -> str:
    """One embedding: its shape, its form and, where it is open, its mean."""
    held = capture.embedding
    shape = " x ".join(str(count) for count in held.shape)
    mean = "" if isinstance(held, SealedEmbedding) else f"  mean {np.asarray(held).mean():.4g}"
    return (
        f"{capture.id}  epoch {capture.epoch}  {shape} {held.form}{mean}{replay_in_words(capture)}"
    )


def classification_in_words(found: Classification) -> str:
    """Return the belief in words."""
    label = f"{found.label}{sure_in_words(found.confidence)}"
    return f"{label}  epoch {found.epoch}{replay_in_words(found)}"


def diagnostics_in_words(found: Diagnostics) -> str:
    """Versions, settings, and what failed lately."""
    lines = [
        *(f"version   {name} {text}" for name, text in found.versions.items()),
        *(f"setting   {name} {dumps(value)}" for name, value in found.settings.items()),
        *(f"events    {count} {kind}" for kind, count in found.events.items()),
    ]
    for past in found.states:
        why = f": {past.detail}" if past.detail else ""
        remedy = _remedy(past.remedy)
        lines.append(f"state     {past.at:%Y-%m-%d %H:%M:%S}  {past.state}{why}{remedy}")
    lines += [
        f"fault     {fault.at:%Y-%m-%d %H:%M:%S}  {fault.code}: {fault.detail}"
        f"{_remedy(fault.remedy)}"
        for fault in found.faults
    ]
    return "\n".join(lines)


def dated_in_words(event: Event) -> str:
    """Return an event with its time, in one line."""
    return f"{event.at:%H:%M:%S}  {event.kind:<14}  {event_in_words(event)}"


def event_in_words(event: Event) -> str:
    """Return an event, in one line."""
    match event:
        case Classified() | CaptureTaken():
            return _taken_in_words(event)
        case MaskChanged():
            return f"epoch {event.epoch}"
        case StateChanged():
            return f"{event.state}  {event.detail or ''}{_remedy(event.remedy)}".rstrip()
        case Seen() | Gone():
            return _sight_in_words(event)
        case BundleChanged():
            version = f"  version {event.version}" if event.version or event.older else ""
            older = ", older than the one before" if event.older else ""
            return f"{event.task}  bundle {event.digest[:12]}{version}{older}"
    return _rare_in_words(event)


def _sight_in_words(event: Seen | Gone) -> str:
    lasted = f"{event.label}{sure_in_words(event.confidence)}  {event.duration_s:.1f} s"
    return lasted if isinstance(event, Seen) or event.reason == "left" else f"{lasted}  not looking"


def _clock_in_words(clock: WallClock) -> str:
    return f"clock     {clock.zone}, {'' if clock.synchronised else 'not '}synchronised"


def activity_in_words(policy: WatchPolicy, activity: Activity, detail: str | None) -> str:
    """Return the policy of the watch and its present activity."""
    words = "off"
    if not isinstance(policy, WatchOff):
        rate = f"looks {policy.rate_hz:.3g}/s" if isinstance(policy, Watching) else "on request"
        quiet = policy.quiet
        words = rate if quiet is None else f"{rate}, not between {quiet.begin} and {quiet.end}"
    return f"{words}: {activity}{f', {detail}' if detail else ''}"


def sure_in_words(confidence: float | None) -> str:
    """Return the probability, where it is told."""
    return "" if confidence is None else f"  {100 * confidence:.1f} %"


def _taken_in_words(event: Classified | CaptureTaken) -> str:
    label = f"{event.label}  " if event.kind != "capture" else ""
    return f"{label}epoch {event.epoch}{'  replay' if event.replay else ''}"


def _rare_in_words(
    event: RotationChanged | WatchChanged | Believed | CalibrationChanged | Fault | Gap,
) -> str:
    if isinstance(event, RotationChanged):
        return policy_in_words(event.policy)
    if isinstance(event, WatchChanged):
        return activity_in_words(event.policy, event.activity, event.detail)
    if isinstance(event, Believed):
        return "nothing" if event.sighting is None else event.sighting.label
    if isinstance(event, CalibrationChanged):
        return run_in_words(event.run)
    if isinstance(event, Fault):
        return f"{event.code}: {event.detail}{_remedy(event.remedy)}"
    return "the daemon was restarted" if event.missed is None else f"{event.missed} events missed"


def _remedy(remedy: Remedy | None) -> str:
    return f"  remedy: {remedy}" if remedy else ""


def bundle_in_words(installed: InstalledBundle) -> str:
    """Return a bundle, in one line; a star stands at the one in use."""
    star, held = ("*" if installed.active else " "), installed.bundle
    content = "damaged" if held is None else f"{held.task}, {masks_in_words(held)}"
    if held is not None and held.version:
        content += f", version {held.version}"
        content += f" signed by {held.signed_by}" if held.signed_by else " not signed"
    if held is not None and held.card is not None:
        content += f", privacy card: {held.card.outcome}" + (" (quick)" if held.card.quick else "")
    own = "  configured" if installed.configured else ""
    return f"{star} {installed.digest[:12]}  {installed.size / 1e6:7.1f} MB  {content}{own}"
