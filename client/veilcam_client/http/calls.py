"""Every request of the API as data: what to send and how to read the answer.

The sync and the async camera share these, so they cannot drift apart.
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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
from veilcam_client.wire.captures import (
    Capture,
    Classification,
    ClassificationRequest,
    Rotation,
    RotationPolicy,
    Status,
)
from veilcam_client.wire.diagnostics import Diagnostics
from veilcam_client.wire.lease import Lease, LeaseRequest, NewLease
from veilcam_client.wire.simulation import PICTURE_MEDIA_TYPE, HeldScene
from veilcam_client.wire.tokens import NewToken, Scope, Token, TokenRequest, Tokens

AnswerT = TypeVar("AnswerT", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Call(Generic[AnswerT]):
    """One request; repeating it carries the same idempotency key."""

    method: str
    path: str
    answer: type[AnswerT]
    body: bytes | None = None
    headers: Mapping[str, str] = field(default_factory=dict)


def _headers(*, body: bool = False, post: bool = False) -> dict[str, str]:
    headers = {"Accept": "application/json"}
    if body:
        headers["Content-Type"] = "application/json"
    if post:
        headers["Idempotency-Key"] = uuid.uuid4().hex
    return headers


def status() -> Call[Status]:
    """GET /v1/status."""
    return Call("GET", "/v1/status", Status, headers=_headers())


def calibration() -> Call[CalibrationStatus]:
    """GET /v1/calibration."""
    return Call("GET", "/v1/calibration", CalibrationStatus, headers=_headers())


def start_calibration(repeats: int) -> Call[CalibrationRun]:
    """POST /v1/calibration."""
    body = CalibrationRequest(repeats=repeats).model_dump_json().encode()
    return Call("POST", "/v1/calibration", CalibrationRun, body, _headers(body=True, post=True))


def confirm_scene(scene: SceneName) -> Call[CalibrationRun]:
    """POST /v1/calibration/scene."""
    body = SceneConfirmation(scene=scene).model_dump_json().encode()
    path = "/v1/calibration/scene"
    return Call("POST", path, CalibrationRun, body, _headers(body=True, post=True))


def cancel_calibration() -> Call[CalibrationRun]:
    """DELETE /v1/calibration."""
    return Call("DELETE", "/v1/calibration", CalibrationRun, headers=_headers())


def capture() -> Call[Capture]:
    """POST /v1/captures."""
    return Call("POST", "/v1/captures", Capture, headers=_headers(post=True))


def classify(include_embedding: bool) -> Call[Classification]:
    """POST /v1/classifications."""
    path = "/v1/classifications"
    if not include_embedding:
        # What a body would say goes without saying, and without it the request is one packet.
        return Call("POST", path, Classification, headers=_headers(post=True))
    request = ClassificationRequest(include_embedding=True)
    body = request.model_dump_json().encode()
    return Call("POST", path, Classification, body, _headers(body=True, post=True))


def rotation() -> Call[Rotation]:
    """GET /v1/rotation."""
    return Call("GET", "/v1/rotation", Rotation, headers=_headers())


def set_rotation(policy: RotationPolicy) -> Call[Rotation]:
    """PUT /v1/rotation."""
    return Call(
        "PUT",
        "/v1/rotation",
        Rotation,
        policy.model_dump_json().encode(),
        _headers(body=True),
    )


def rotate() -> Call[Rotation]:
    """POST /v1/rotation/advance."""
    return Call("POST", "/v1/rotation/advance", Rotation, headers=_headers(post=True))


def lease_state() -> Call[Lease]:
    """GET /v1/lease."""
    return Call("GET", "/v1/lease", Lease, headers=_headers())


def take_lease(seconds: float, owner: str) -> Call[NewLease]:
    """POST /v1/lease."""
    request = LeaseRequest(owner=owner, seconds=seconds)
    return Call(
        "POST",
        "/v1/lease",
        NewLease,
        request.model_dump_json().encode(),
        _headers(body=True, post=True),
    )


def release_lease(force: bool = False) -> Call[Lease]:
    """DELETE /v1/lease."""
    path = "/v1/lease?force=true" if force else "/v1/lease"
    return Call("DELETE", path, Lease, headers=_headers())


def diagnostics() -> Call[Diagnostics]:
    """GET /v1/diagnostics."""
    return Call("GET", "/v1/diagnostics", Diagnostics, headers=_headers())


def tokens() -> Call[Tokens]:
    """GET /v1/tokens."""
    return Call("GET", "/v1/tokens", Tokens, headers=_headers())


def create_token(label: str, scopes: Sequence[Scope], seconds: int | None) -> Call[NewToken]:
    """POST /v1/tokens."""
    request = TokenRequest(label=label, scopes=tuple(scopes), seconds=seconds)
    return Call(
        "POST",
        "/v1/tokens",
        NewToken,
        request.model_dump_json().encode(),
        _headers(body=True, post=True),
    )


def revoke_token(token_id: str) -> Call[Token]:
    """DELETE /v1/tokens/ID."""
    return Call("DELETE", f"/v1/tokens/{quote(token_id, safe='')}", Token, headers=_headers())


def hold_scene(picture: bytes) -> Call[HeldScene]:
    """PUT /v1/simulation/scene."""
    headers = {**_headers(), "Content-Type": PICTURE_MEDIA_TYPE}
    return Call("PUT", "/v1/simulation/scene", HeldScene, picture, headers)


def take_scene_away() -> Call[HeldScene]:
    """DELETE /v1/simulation/scene."""
    return Call("DELETE", "/v1/simulation/scene", HeldScene, headers=_headers())


def keyrings() -> Call[Keyrings]:
    """GET /v1/keyrings."""
    return Call("GET", "/v1/keyrings", Keyrings, headers=_headers())


def install_keyring(bundle: bytes) -> Call[Keyring]:
    """POST /v1/keyrings; to repeat it changes nothing."""
    headers = {**_headers(), "Content-Type": BUNDLE_MEDIA_TYPE}
    return Call("POST", "/v1/keyrings", Keyring, bundle, headers)


def activate_keyring(digest: str) -> Call[Keyring]:
    """POST /v1/keyrings/DIGEST/activate."""
    path = f"/v1/keyrings/{quote(digest, safe='')}/activate"
    return Call("POST", path, Keyring, headers=_headers(post=True))


def remove_keyring(digest: str) -> Call[Keyrings]:
    """DELETE /v1/keyrings/DIGEST."""
    return Call("DELETE", f"/v1/keyrings/{quote(digest, safe='')}", Keyrings, headers=_headers())
