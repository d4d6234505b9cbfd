"""Every request of the API as data: what to send and how to read the answer.

The sync and the async camera share these, so they cannot drift apart.
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar
from urllib.parse import quote

from pydantic import BaseModel

from veilcam_client.arguments import model, of_type, segment, whole
from veilcam_client.wire.base import Nothing
from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE, InstalledBundle, InstalledBundles
from veilcam_client.wire.calibration import (
    CalibrationRequest,
    CalibrationRun,
    CalibrationStatus,
    SceneConfirmation,
    SceneName,
)
from veilcam_client.wire.captures import (
    NPY_MEDIA_TYPE,
    Capture,
    Classification,
    ClassificationRequest,
)
from veilcam_client.wire.lease import Lease, LeaseRequest, NewLease
from veilcam_client.wire.log import RECORDS_AT_ONCE, LogHead, LogRecords
from veilcam_client.wire.rotation import (
    EveryCaptures,
    EverySeconds,
    Rotation,
    RotationOff,
    RotationPolicy,
)
from veilcam_client.wire.sealing import PairedReceiver, ReceiverRequest, Receivers
from veilcam_client.wire.simulation import Faults, HeldScene, picture_media_type
from veilcam_client.wire.status import Diagnostics, Status
from veilcam_client.wire.tokens import (
    MOST_TOKENS,
    NewToken,
    Scope,
    Token,
    TokenRequest,
    Tokens,
)
from veilcam_client.wire.watch import OnRequest, Watch, Watching, WatchOff, WatchPolicy

AnswerT = TypeVar("AnswerT", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Call(Generic[AnswerT]):
    """One request; with ``once`` it carries a key by which a repetition is known."""

    method: str
    path: str
    answer: type[AnswerT]
    body: BaseModel | bytes | None = None
    media_type: str = "application/json"
    once: bool = False
    accept: str = "application/json"

    def content(self) -> bytes | None:
        """Return the body as it is sent."""
        return (
            self.body.model_dump_json().encode() if isinstance(self.body, BaseModel) else self.body
        )

    def headers(self) -> dict[str, str]:
        """Headers of one request and of all its repetitions."""
        headers = {"Accept": self.accept, "Accept-Encoding": "identity"}
        if self.body is not None:
            headers["Content-Type"] = self.media_type
        if self.once:
            headers["Idempotency-Key"] = uuid.uuid4().hex
        return headers


STATUS = Call("GET", "/v1/status", Status)
CALIBRATION = Call("GET", "/v1/calibration", CalibrationStatus)
CANCEL_CALIBRATION = Call("DELETE", "/v1/calibration", CalibrationRun)
# As an array where it is one: it is read several times faster, and a sealed one is none.
CAPTURE = Call(
    "POST",
    "/v1/captures",
    Capture,
    once=True,
    accept=f"{NPY_MEDIA_TYPE}, application/json;q=0.9",
)
ROTATION = Call("GET", "/v1/rotation", Rotation)
ROTATE = Call("POST", "/v1/rotation/advance", Rotation, once=True)
WATCH = Call("GET", "/v1/watch", Watch)
LEASE_STATE = Call("GET", "/v1/lease", Lease)
DIAGNOSTICS = Call("GET", "/v1/diagnostics", Diagnostics)
TAKE_SCENE_AWAY = Call("DELETE", "/v1/simulation/scene", HeldScene)
BUNDLES = Call("GET", "/v1/bundles", InstalledBundles)
LOG_HEAD = Call("GET", "/v1/log/head", LogHead)
RECEIVERS = Call("GET", "/v1/receivers", Receivers)


def start_calibration(repeats: int) -> Call[CalibrationRun]:
    """POST /v1/calibration."""
    body = model(CalibrationRequest, {"repeats": repeats})
    return Call("POST", "/v1/calibration", CalibrationRun, body, once=True)


def confirm_scene(scene: SceneName) -> Call[CalibrationRun]:
    """POST /v1/calibration/scene."""
    body = model(SceneConfirmation, {"scene": scene})
    return Call("POST", "/v1/calibration/scene", CalibrationRun, body, once=True)


def classify(include_embedding: bool) -> Call[Classification]:
    """POST /v1/classifications."""
    # What a body would say goes without saying, and without it the request is one packet.
    asked = model(ClassificationRequest, {"include_embedding": include_embedding})
    body = asked if asked.include_embedding else None
    return Call("POST", "/v1/classifications", Classification, body, once=True)


def set_rotation(policy: RotationPolicy) -> Call[Rotation]:
    """PUT /v1/rotation."""
    kinds = (RotationOff, EverySeconds, EveryCaptures)
    of_type("policy", policy, kinds, "RotationOff, EverySeconds or EveryCaptures")
    return Call("PUT", "/v1/rotation", Rotation, policy)


def set_watch(policy: WatchPolicy) -> Call[Watch]:
    """PUT /v1/watch."""
    kinds = (WatchOff, OnRequest, Watching)
    of_type("policy", policy, kinds, "WatchOff, OnRequest or Watching")
    return Call("PUT", "/v1/watch", Watch, policy)


def take_lease(seconds: float, owner: str) -> Call[NewLease]:
    """POST /v1/lease."""
    body = model(LeaseRequest, {"owner": owner, "seconds": seconds})
    return Call("POST", "/v1/lease", NewLease, body, once=True)


def release_lease(force: bool = False) -> Call[Lease]:
    """DELETE /v1/lease."""
    return Call("DELETE", "/v1/lease?force=true" if force else "/v1/lease", Lease)


def tokens(limit: int, after: str | None) -> Call[Tokens]:
    """GET /v1/tokens."""
    start = "" if after is None else f"&after={quote(segment('after', after), safe='')}"
    limit = whole("limit", limit, 1, MOST_TOKENS)
    return Call("GET", f"/v1/tokens?limit={limit}{start}", Tokens)


def log(limit: int, after: int | None) -> Call[LogRecords]:
    """GET /v1/log."""
    start = "" if after is None else f"&after={whole('after', after, 0)}"
    limit = whole("limit", limit, 1, RECORDS_AT_ONCE)
    return Call("GET", f"/v1/log?limit={limit}{start}", LogRecords)


def create_token(label: str, scopes: Sequence[Scope], seconds: int | None) -> Call[NewToken]:
    """POST /v1/tokens."""
    body = model(TokenRequest, {"label": label, "scopes": scopes, "seconds": seconds})
    return Call("POST", "/v1/tokens", NewToken, body, once=True)


def revoke_token(token_id: str) -> Call[Token]:
    """DELETE /v1/tokens/ID."""
    return Call("DELETE", f"/v1/tokens/{_part('token_id', token_id)}", Token)


def add_receiver(label: str, key: str) -> Call[PairedReceiver]:
    """POST /v1/receivers."""
    body = model(ReceiverRequest, {"label": label, "key": key})
    return Call("POST", "/v1/receivers", PairedReceiver, body, once=True)


def remove_receiver(receiver_id: str) -> Call[Nothing]:
    """DELETE /v1/receivers/ID."""
    return Call("DELETE", f"/v1/receivers/{_part('receiver_id', receiver_id)}", Nothing)


def hold_scene(picture: bytes) -> Call[HeldScene]:
    """PUT /v1/simulation/scene; raises ValueError for bytes that are no picture."""
    media_type = picture_media_type(picture)
    return Call("PUT", "/v1/simulation/scene", HeldScene, picture, media_type=media_type)


def set_faults(faults: Faults) -> Call[Faults]:
    """PUT /v1/simulation/faults."""
    of_type("faults", faults, Faults, "Faults(...)")
    return Call("PUT", "/v1/simulation/faults", Faults, faults)


def install_bundle(bundle: bytes) -> Call[InstalledBundle]:
    """POST /v1/bundles; to repeat it changes nothing."""
    of_type("bundle", bundle, bytes, "the content of its file")
    return Call("POST", "/v1/bundles", InstalledBundle, bundle, media_type=BUNDLE_MEDIA_TYPE)


def activate_bundle(digest: str, allow_older: bool = False) -> Call[InstalledBundle]:
    """POST /v1/bundles/DIGEST/activate."""
    of_type("allow_older", allow_older, bool, "True or False")
    path = f"/v1/bundles/{_part('digest', digest)}/activate"
    return Call(
        "POST", f"{path}?allow_older=true" if allow_older else path, InstalledBundle, once=True
    )


def remove_bundle(digest: str) -> Call[InstalledBundles]:
    """DELETE /v1/bundles/DIGEST."""
    return Call("DELETE", f"/v1/bundles/{_part('digest', digest)}", InstalledBundles)


def _part(name: str, value: str) -> str:
    return quote(segment(name, value), safe="")
