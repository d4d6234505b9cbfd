"""Every request of the API as data: what to send and how to read the answer.

The sync and the async camera share these, so they cannot drift apart.
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar
from urllib.parse import quote

from pydantic import BaseModel

from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE, Keyring, Keyrings
from veilcam_client.wire.calibration import (
    CalibrationRequest,
    CalibrationRun,
    CalibrationStatus,
    SceneConfirmation,
    SceneName,
)
from veilcam_client.wire.captures import Capture, Classification, ClassificationRequest
from veilcam_client.wire.diagnostics import Diagnostics
from veilcam_client.wire.lease import Lease, LeaseRequest, NewLease
from veilcam_client.wire.rotation import Rotation, RotationPolicy
from veilcam_client.wire.simulation import PICTURE_MEDIA_TYPE, HeldScene
from veilcam_client.wire.status import Status
from veilcam_client.wire.tokens import NewToken, Scope, Token, TokenRequest, Tokens

AnswerT = TypeVar("AnswerT", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Call(Generic[AnswerT]):
    """One request; repeating it carries the same idempotency key."""

    method: str
    path: str
    answer: type[AnswerT]
    body: bytes | None
    headers: Mapping[str, str]


def _call(
    method: str,
    path: str,
    answer: type[AnswerT],
    body: BaseModel | bytes | None = None,
    *,
    media_type: str = "application/json",
    once: bool = False,
) -> Call[AnswerT]:
    """One request; ``once`` gives it a key by which a repetition is known."""
    headers = {"Accept": "application/json"}
    if body is not None:
        headers["Content-Type"] = media_type
    if once:
        headers["Idempotency-Key"] = uuid.uuid4().hex
    content = body.model_dump_json().encode() if isinstance(body, BaseModel) else body
    return Call(method, path, answer, content, headers)


def status() -> Call[Status]:
    """GET /v1/status."""
    return _call("GET", "/v1/status", Status)


def calibration() -> Call[CalibrationStatus]:
    """GET /v1/calibration."""
    return _call("GET", "/v1/calibration", CalibrationStatus)


def start_calibration(repeats: int) -> Call[CalibrationRun]:
    """POST /v1/calibration."""
    body = CalibrationRequest(repeats=repeats)
    return _call("POST", "/v1/calibration", CalibrationRun, body, once=True)


def confirm_scene(scene: SceneName) -> Call[CalibrationRun]:
    """POST /v1/calibration/scene."""
    body = SceneConfirmation(scene=scene)
    return _call("POST", "/v1/calibration/scene", CalibrationRun, body, once=True)


def cancel_calibration() -> Call[CalibrationRun]:
    """DELETE /v1/calibration."""
    return _call("DELETE", "/v1/calibration", CalibrationRun)


def capture() -> Call[Capture]:
    """POST /v1/captures."""
    return _call("POST", "/v1/captures", Capture, once=True)


def classify(include_embedding: bool) -> Call[Classification]:
    """POST /v1/classifications."""
    # What a body would say goes without saying, and without it the request is one packet.
    body = ClassificationRequest(include_embedding=True) if include_embedding else None
    return _call("POST", "/v1/classifications", Classification, body, once=True)


def rotation() -> Call[Rotation]:
    """GET /v1/rotation."""
    return _call("GET", "/v1/rotation", Rotation)


def set_rotation(policy: RotationPolicy) -> Call[Rotation]:
    """PUT /v1/rotation."""
    return _call("PUT", "/v1/rotation", Rotation, policy)


def rotate() -> Call[Rotation]:
    """POST /v1/rotation/advance."""
    return _call("POST", "/v1/rotation/advance", Rotation, once=True)


def lease_state() -> Call[Lease]:
    """GET /v1/lease."""
    return _call("GET", "/v1/lease", Lease)


def take_lease(seconds: float, owner: str) -> Call[NewLease]:
    """POST /v1/lease."""
    body = LeaseRequest(owner=owner, seconds=seconds)
    return _call("POST", "/v1/lease", NewLease, body, once=True)


def release_lease(force: bool = False) -> Call[Lease]:
    """DELETE /v1/lease."""
    return _call("DELETE", "/v1/lease?force=true" if force else "/v1/lease", Lease)


def diagnostics() -> Call[Diagnostics]:
    """GET /v1/diagnostics."""
    return _call("GET", "/v1/diagnostics", Diagnostics)


def tokens() -> Call[Tokens]:
    """GET /v1/tokens."""
    return _call("GET", "/v1/tokens", Tokens)


def create_token(label: str, scopes: Sequence[Scope], seconds: int | None) -> Call[NewToken]:
    """POST /v1/tokens."""
    body = TokenRequest(label=label, scopes=tuple(scopes), seconds=seconds)
    return _call("POST", "/v1/tokens", NewToken, body, once=True)


def revoke_token(token_id: str) -> Call[Token]:
    """DELETE /v1/tokens/ID."""
    return _call("DELETE", f"/v1/tokens/{quote(token_id, safe='')}", Token)


def hold_scene(picture: bytes) -> Call[HeldScene]:
    """PUT /v1/simulation/scene."""
    path = "/v1/simulation/scene"
    return _call("PUT", path, HeldScene, picture, media_type=PICTURE_MEDIA_TYPE)


def take_scene_away() -> Call[HeldScene]:
    """DELETE /v1/simulation/scene."""
    return _call("DELETE", "/v1/simulation/scene", HeldScene)


def keyrings() -> Call[Keyrings]:
    """GET /v1/keyrings."""
    return _call("GET", "/v1/keyrings", Keyrings)


def install_keyring(bundle: bytes) -> Call[Keyring]:
    """POST /v1/keyrings; to repeat it changes nothing."""
    return _call("POST", "/v1/keyrings", Keyring, bundle, media_type=BUNDLE_MEDIA_TYPE)


def activate_keyring(digest: str) -> Call[Keyring]:
    """POST /v1/keyrings/DIGEST/activate."""
    return _call("POST", f"/v1/keyrings/{quote(digest, safe='')}/activate", Keyring, once=True)


def remove_keyring(digest: str) -> Call[Keyrings]:
    """DELETE /v1/keyrings/DIGEST."""
    return _call("DELETE", f"/v1/keyrings/{quote(digest, safe='')}", Keyrings)
