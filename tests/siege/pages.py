"""Row of the foreign page: requests with the headers that a browser puts on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from tests.siege.client import Address
from tests.siege.ground import Ground, Judgement, second_bundle

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_client.wire.rotation import RotationOff
from veilcam_client.wire.sealing import ReceiverRequest

Headers = Mapping[str, str]

_ORIGIN = {"Origin": "https://evil.example"}
_CROSS: Headers = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}
_FETCH: Headers = {**_ORIGIN, **_CROSS, "Sec-Fetch-Dest": "empty"}
_NAVIGATE: Headers = {"Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
_FORM: Headers = {**_ORIGIN, "Sec-Fetch-Site": "cross-site", **_NAVIGATE}
_PREFLIGHT: Headers = {**_ORIGIN, "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"}
_TEXT: Headers = {"Content-Type": "text/plain;charset=UTF-8"}
_ENCODED: Headers = {"Content-Type": "application/x-www-form-urlencoded"}
_JSON: Headers = {"Content-Type": "application/json"}
_BUNDLE: Headers = {"Content-Type": BUNDLE_MEDIA_TYPE}
ADVANCE, CAPTURE, LEASE = "/v1/rotation/advance", "/v1/classifications", "/v1/lease"


@dataclass(frozen=True, slots=True)
class PageRequest:
    method: str
    path: str
    page: Headers
    own: Headers = field(default_factory=dict)
    body: bytes | None = None


def page_requests(address: Address, bundle: bytes) -> list[PageRequest]:
    place = urlsplit(address.url)
    other_port = {"Origin": f"http://{place.hostname}:{(place.port or 0) + 1}"}
    rebound = {"Host": "evil.example", "Origin": "http://evil.example"}
    policy, lease = b'{"mode":"captures","captures":7}', b'{"owner":"page","seconds":60}'
    own = ReceiverRequest(label="page", key=str(ReceiverKey.generate().public))
    pairing = own.model_dump_json().encode()
    get = _CROSS  # no Origin: a page may ask without CORS
    return [
        PageRequest("POST", ADVANCE, _FETCH),
        PageRequest("POST", ADVANCE, {**_FETCH, "Origin": "null"}),
        PageRequest("POST", ADVANCE, _ORIGIN),  # as over plain HTTP on a LAN
        PageRequest("POST", ADVANCE, {**_FETCH, **other_port, "Sec-Fetch-Site": "same-site"}),
        PageRequest("POST", ADVANCE, {**rebound, "Sec-Fetch-Site": "same-origin"}),
        PageRequest("POST", ADVANCE, {**_FORM, **_ENCODED}),
        PageRequest("POST", CAPTURE, {**_FETCH, **_TEXT}, _JSON, b"{}"),
        PageRequest("POST", CAPTURE, {**_FORM, "Content-Type": "text/plain"}, _JSON, b"{}"),
        PageRequest("POST", "/v1/receivers", {**_FETCH, **_TEXT}, _JSON, pairing),
        PageRequest("POST", LEASE, {**_ORIGIN, **_TEXT}, _JSON, lease),
        PageRequest("POST", "/v1/bundles", {**_FETCH, **_TEXT}, _BUNDLE, bundle),
        PageRequest("PUT", "/v1/rotation", {**_PREFLIGHT, **_JSON}, _JSON, policy),
        PageRequest("GET", "/v1/status", {**get, "Sec-Fetch-Dest": "image"}),
        PageRequest("GET", "/v1/status", {**_FORM, "Sec-Fetch-Dest": "iframe"}),
        PageRequest("GET", "/v1/status", {**rebound, "Sec-Fetch-Site": "same-origin"}),
        PageRequest("GET", "/v1/bundles", {**get, "Sec-Fetch-Dest": "script"}),
        PageRequest("GET", "/v1/diagnostics", _FORM),
        PageRequest("GET", "/v1/receivers", _PREFLIGHT),
        PageRequest("GET", "/v1/rotation", _ORIGIN),
        # The last: while it goes on, nothing else does.
        PageRequest("POST", "/v1/calibration", _FETCH),
    ]


async def foreign_page(ground: Ground, judgement: Judgement) -> None:
    settings = ground.settings("page", auth="none", rotation=RotationOff(), callers=1024)
    acted: list[str] = []
    idle: list[str] = []
    with ground.start(settings) as daemon:
        address = daemon.address
        asked = page_requests(address, second_bundle(settings))
        for request in asked:
            name = f"{request.method} {request.path}"
            if await _acts(address, request, {**request.own, **request.page}):
                acted.append(name)
            if not await _acts(address, request, request.own):
                idle.append(name)
    judgement.none(f"of {len(asked)} requests of a page act", acted)
    judgement.none("do nothing without the page", idle)


async def _acts(address: Address, request: PageRequest, headers: Headers) -> bool:
    """Return whether a request is answered, or changes the daemon; undo what keeps others idle."""
    before = await _standing(address)
    reply = await address.ask(request.method, request.path, request.body, headers)
    acts = 200 <= reply.status < 300 or await _standing(address) != before
    await address.ask("DELETE", "/v1/lease?force=true")
    await address.ask("DELETE", "/v1/calibration")
    return acts


async def _standing(address: Address) -> list[object]:
    told = await address.get("status")
    rotation = told["rotation"]
    others = [await address.get(name) for name in ("bundles", "lease", "calibration", "receivers")]
    return [told["captures"], rotation["policy"], rotation["epoch"], told["state"], *others]
