"""A line of curl and one of Python for every operation, as the OpenAPI document shows them.

``$NAME`` stands for what only the caller knows, in Python for a variable of that name in small
letters; ``camera`` is ``veilcam_client.Camera(token=token)``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import JsonValue

from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_server.security.sessions import HEADER

URL = "http://127.0.0.1:8787"
_BEARER = '-H "Authorization: Bearer $TOKEN"'
_NAMES = {"digest": "DIGEST", "token_id": "TOKEN_ID", "receiver_id": "RECEIVER_ID"}
"""Parameters of paths, as a caller's variables."""


@dataclass(frozen=True, slots=True)
class Sample:
    """Sample request of an operation.

    Attributes:
        python: a line with the SDK; None: the SDK has no such call, and httpx asks.
        body: body of the request, as JSON.
        file: file to send, and its kind.
        options: further ones of curl.
    """

    python: str | None = None
    body: Mapping[str, JsonValue] | None = None
    file: tuple[str, str] | None = None
    options: str = ""


SAMPLES: Mapping[str, Sample] = {
    "capture": Sample("camera.capture()"),
    "classify": Sample("camera.classify()"),
    "rotation": Sample("camera.rotation.get()"),
    "set_rotation": Sample(
        "camera.rotation.set(EverySeconds(seconds=30.0))", {"mode": "seconds", "seconds": 30.0}
    ),
    "rotate": Sample("camera.rotation.advance()"),
    "watch": Sample("camera.watch.get()"),
    "set_watch": Sample(
        "camera.watch.set(Watching(rate_hz=2.0))", {"mode": "watching", "rate_hz": 2.0}
    ),
    "events": Sample("next(camera.events())", options="--no-buffer"),
    "lease_state": Sample("camera.lease.get()"),
    "take_lease": Sample(
        'camera.lease.take(seconds=60.0, owner="an experiment")',
        {"owner": "an experiment", "seconds": 60.0},
    ),
    "release_lease": Sample("camera.lease.release()"),
    "log": Sample("camera.log.list()"),
    "tokens": Sample("camera.tokens.list()"),
    "create_token": Sample(
        'camera.tokens.create("lamp", ["classify"], seconds=86_400)',
        {"label": "lamp", "scopes": ["classify"], "seconds": 86_400},
    ),
    "revoke_token": Sample("camera.tokens.revoke(token_id)"),
    "receivers": Sample("camera.receivers.list()"),
    "add_receiver": Sample(
        'camera.receivers.add("archive", receiver_key)',
        {"label": "archive", "key": "$RECEIVER_KEY"},
    ),
    "remove_receiver": Sample("camera.receivers.remove(receiver_id)"),
    "offer_pairing": Sample('camera.receivers.offer("operator")', {"role": "operator"}),
    "claim_pairing": Sample(
        'camera.receivers.claim(secret, "laptop", receiver_key)',
        {"label": "laptop", "key": "$RECEIVER_KEY", "secret": "$SECRET"},
    ),
    "status": Sample("camera.status()"),
    "diagnostics": Sample("camera.diagnostics()"),
    "privacy": Sample(),
    "calibration": Sample("camera.calibration.get()"),
    "start_calibration": Sample("camera.calibration.start(repeats=2)", {"repeats": 2}),
    "confirm_scene": Sample('camera.calibration.confirm("lamp")', {"scene": "lamp"}),
    "cancel_calibration": Sample("camera.calibration.cancel()"),
    "bundles": Sample("camera.bundles.list()"),
    "install_bundle": Sample(
        'camera.bundles.install(Path("hall.veilcam").read_bytes())',
        file=("hall.veilcam", BUNDLE_MEDIA_TYPE),
    ),
    "activate_bundle": Sample("camera.bundles.activate(digest)"),
    "remove_bundle": Sample("camera.bundles.remove(digest)"),
    "session": Sample(),
    "begin_session": Sample(options="--cookie-jar cookies"),
    "end_session": Sample(options=f'--cookie cookies -H "{HEADER}: $HALF"'),
    "hold_scene": Sample(
        'camera.simulation.hold_scene(Path("scene.png").read_bytes())',
        file=("scene.png", "image/png"),
    ),
    "take_scene_away": Sample("camera.simulation.hold_scene(None)"),
    "set_faults": Sample(
        "camera.simulation.set_faults(Faults(panel=PanelFaults(dead=True)))",
        {"panel": {"dead": True}},
    ),
}
"""By the id of the operation, where there is more to say than method, path and token."""


def code_samples(
    operation: str, method: str, path: str, *, token: bool
) -> list[dict[str, JsonValue]]:
    """Return both lines, as the extension ``x-codeSamples`` of OpenAPI has them.

    Args:
        operation: id of the operation.
        method: method in capitals.
        path: template of the route.
        token: True where the operation wants a token.
    """
    sample = SAMPLES.get(operation, Sample())
    python = sample.python or _httpx(method, path, token=token)
    return [
        {"lang": "curl", "source": _curl(sample, method, path, token=token)},
        {"lang": "Python", "source": python},
    ]


def _curl(sample: Sample, method: str, path: str, *, token: bool) -> str:
    words = ["curl", sample.options]
    if method != "GET":
        words.append(f"-X {method}")
    # The end of a session is asked with its two halves, as the page does.
    if token and HEADER not in sample.options:
        words.append(_BEARER)
    if sample.file is not None:
        name, media_type = sample.file
        words += [f'-H "Content-Type: {media_type}"', f"--data-binary @{name}"]
    elif sample.body is not None:
        words.append(_quoted(json.dumps(sample.body)))
    words.append(URL + re.sub(r"\{(\w+)\}", lambda found: f"${_name(found[1])}", path))
    return " ".join(filter(None, words))


def _name(parameter: str) -> str:
    return _NAMES.get(parameter, parameter.upper())


def _quoted(body: str) -> str:
    # A shell puts in what is between double quotes alone.
    if "$" in body:
        escaped = body.replace('"', '\\"')
        return f'--json "{escaped}"'
    return f"--json '{body}'"


def _httpx(method: str, path: str, *, token: bool) -> str:
    url = re.sub(r"\{(\w+)\}", lambda found: f"{{{_name(found[1]).lower()}}}", URL + path)
    prefix = "f" if "{" in url else ""
    headers = ', headers={"Authorization": f"Bearer {token}"}' if token else ""
    return f'httpx.{method.lower()}({prefix}"{url}"{headers})'
