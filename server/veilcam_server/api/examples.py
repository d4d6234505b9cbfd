"""One example of everything that goes over the wire, for the OpenAPI document."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime

from pydantic import BaseModel

from veilcam_client import __version__
from veilcam_client.wire.bundles import Keyring, Keyrings
from veilcam_client.wire.calibration import (
    CalibrationRecord,
    CalibrationRequest,
    CalibrationRun,
    CalibrationStatus,
    Quantity,
    SceneConfirmation,
    SignedCalibration,
)
from veilcam_client.wire.captures import (
    API_VERSION,
    BundleInfo,
    Capture,
    Classification,
    ClassificationRequest,
    Device,
    Embedding,
    EveryCaptures,
    EverySeconds,
    Exposure,
    Preparation,
    Queue,
    Rotation,
    RotationOff,
    Status,
    Timing,
)
from veilcam_client.wire.diagnostics import Diagnostics, PastFault, PastState
from veilcam_client.wire.lease import Lease, LeaseRequest, NewLease
from veilcam_client.wire.simulation import HeldScene
from veilcam_client.wire.tokens import NewToken, Token, TokenRequest, Tokens

_AT = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
_EPOCH = "9f86d081884c7d659a2feaa0c55ad015"
_DIGEST = "0f" * 32
_EXPOSURE = Exposure(started_after_shown_s=0.104, settle_s=0.1, duration_s=0.01)
_TIMING = Timing(
    queue_s=0.0, rotation_s=0.02, settle_s=0.08, capture_s=0.05, inference_s=0.001, total_s=0.16
)
_EMBEDDING = Embedding(form="white", shape=(2, 3), values=(0.1, -1.2, 0.4, 0.9, -0.3, 0.0))
_ROTATION = Rotation(
    policy=EveryCaptures(captures=10),
    epoch=_EPOCH,
    captures=3,
    preparation=Preparation(ready=True, prepared=12, last_s=0.03, late=0, reused=0),
)
_BUNDLE = BundleInfo(
    digest=_DIGEST, task="mnist", mode="pairs", labels=("0", "1"), embedding_shape=(2, 3), pairs=6
)
_KEYRING = Keyring(digest=_DIGEST, size=48_213, active=True, configured=False, bundle=_BUNDLE)
_TOKEN = Token(
    id="0123456789ab",
    label="lamp",
    scopes=("classify", "read:status"),
    created_at=_AT,
    expires_at=None,
    revoked_at=None,
    last_used_on="2026-01-02",
)
_LEASE = Lease(held=True, owner="an experiment", expires_in_s=58.5, mine=True)


def _quantity(value: float) -> Quantity:
    return Quantity(value=value, uncertainty=0.01, residual=0.002)


_RECORD = CalibrationRecord(
    taken_at=_AT,
    temperature_c=23.5,
    display="ST7735R",
    sensor="IMX477",
    simulated=False,
    exposure_s=0.01,
    geometry=_DIGEST,
    settling_s=_quantity(0.06),
    black_level=_quantity(0.0),
    gain=_quantity(1.0),
    full_scale=_quantity(4.0),
    gamma=_quantity(1.0),
    contrast_floor=_quantity(0.02),
    dead_transmittance=_quantity(0.5),
    shift_y_m=_quantity(1e-5),
    shift_x_m=_quantity(-2e-5),
    rotation_rad=_quantity(0.001),
    distance_error_m=_quantity(2e-5),
    stray_light=_quantity(0.01),
    psf_residual=0.01,
    drift=0.001,
)

_RUN = CalibrationRun(
    stage="waiting",
    scene="lamp",
    instruction="Put a lamp behind a hole of 17.1 x 17.1 mm in black card.",
    exposures=290,
    total=330,
    detail=None,
)

_ALL: tuple[BaseModel, ...] = (
    Status(
        version=__version__,
        api_version=API_VERSION,
        state="ready",
        uptime_s=3600.0,
        captures=1200,
        release="white",
        device=Device(display="ST7735R", sensor="IMX477", simulated=False),
        bundle=_BUNDLE,
        rotation=_ROTATION,
        queue=Queue(waiting=0, limit=8),
    ),
    Capture(
        id="c0ffee00c0ffee00",
        taken_at=_AT,
        epoch=_EPOCH,
        embedding=_EMBEDDING,
        exposure=_EXPOSURE,
        timing=_TIMING,
    ),
    Classification(
        id="c0ffee00c0ffee00",
        taken_at=_AT,
        epoch=_EPOCH,
        label="1",
        confidence=0.98,
        scores={"0": 0.02, "1": 0.98},
        exposure=_EXPOSURE,
        timing=_TIMING,
    ),
    ClassificationRequest(include_embedding=True),
    _ROTATION,
    RotationOff(),
    EverySeconds(seconds=30.0, jitter=5.0),
    EveryCaptures(captures=10, reuse=2),
    LeaseRequest(owner="an experiment", seconds=60.0),
    _LEASE,
    NewLease(**_LEASE.model_dump(), secret=None),
    TokenRequest(label="lamp", scopes=("classify", "read:status"), seconds=86_400),
    _TOKEN,
    NewToken(**_TOKEN.model_dump(), secret="vc_0123456789ab_" + "0f" * 32),
    Tokens(tokens=(_TOKEN,)),
    Diagnostics(
        versions={"veilcam": __version__, "python": "3.11.9"},
        settings={"device": "pi", "queue_limit": 8, "bundle": "given"},
        states=(PastState(at=_AT, state="ready", detail=None),),
        faults=(PastFault(at=_AT, code="sensor_timeout", detail="no frame in 5 s"),),
        events={"capture": 1200, "mask": 120},
        fault_counts={"sensor_timeout": 1},
        audit_lost=0,
    ),
    CalibrationRequest(repeats=2),
    SceneConfirmation(scene="lamp"),
    _RUN,
    CalibrationStatus(
        signed=SignedCalibration(record=_RECORD, public_key=_DIGEST, signature=2 * _DIGEST),
        run=_RUN,
    ),
    _KEYRING,
    Keyrings(keyrings=(_KEYRING,)),
    HeldScene(scene=1),
)
EXAMPLES: Mapping[str, BaseModel] = {type(example).__name__: example for example in _ALL}
"""By the name of the model."""
METRICS = "# TYPE veilcam_captures_total counter\nveilcam_captures_total 1200.0\n"
EVENTS = (
    'event: mask\nid: 5ca1ab1e-7\ndata: {"id":"5ca1ab1e-7","at":"2026-01-02T03:04:05Z",'
    f'"kind":"mask","epoch":"{_EPOCH}"}}\n\n'
)
