"""The OpenAPI document: what FastAPI finds out, with problems, headers, examples and samples."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.constants import REF_PREFIX
from pydantic import BaseModel

from veilcam_client import wire
from veilcam_client.wire import events
from veilcam_client.wire.base import CALL_HEADER, PROBLEM_MEDIA_TYPE, RUN_HEADER, Problem
from veilcam_client.wire.captures import NPY_MEDIA_TYPE
from veilcam_server.api import metrics
from veilcam_server.api.problems import example_of
from veilcam_server.api.samples import code_samples
from veilcam_server.api.sizes import PADDING_HEADER, PATHS
from veilcam_server.errors import PROBLEMS

TAGS: Mapping[str, str] = {
    "Captures": "Embeddings and labels, one look at a time.",
    "Watch": "The camera that looks by itself, and what it believes to see.",
    "Events": "What happens, as it happens.",
    "Masks": "When masks change, and which one is shown.",
    "Status": "How the camera and its machine are.",
    "Lease": "The camera for oneself, for a while.",
    "Calibration": "The camera, measured with itself.",
    "Receivers": "To whom embeddings are sealed.",
    "Log": "Signed records of what was answered.",
    "Bundles": "Masks, and what reads behind them.",
    "Tokens": "Who may ask, and for what.",
    "Session": "How a page asks without keeping a token.",
    "Simulation": "What a simulated camera looks at, and what is wrong with it.",
    "Pages": "What wants no token: the pages for people, and two words for monitors.",
}
"""Subjects of operations, with what they are about."""
_HEADERS: Mapping[str, tuple[str, str]] = {
    "X-Request-Id": ("Name of the request, as the log has it.", "5ca1ab1e0ddba11"),
    CALL_HEADER: ("That of the request, where it sent 32 hexadecimal digits.", "5ca1ab1e" * 4),
    RUN_HEADER: ("Name of this run of the daemon.", "c0ffee00" * 4),
    "Cache-Control": ("Nobody keeps it, but for who asks again with its `ETag`.", "no-store"),
    PADDING_HEADER: ("Fills up the head of an answer, which has one size.", "000"),
    "ETag": ("Send it as `If-None-Match`: 304 as long as it holds.", 'W/"0f0f"'),
    "Retry-After": ("Before the same request may succeed [s].", "1"),
    "WWW-Authenticate": ("That a token is wanted.", 'Bearer realm="veilcam"'),
    "Set-Cookie": ("The half of a session that no script can read.", "veilcam-session=0f0f"),
    "Veilcam-Capture": ("`id` of a capture that comes as an array.", "c0ffee00"),
    "Veilcam-Epoch": ("Its `epoch`.", "9f86d081884c7d65"),
    "Veilcam-Number": ("Its `number`.", "0"),
    "Veilcam-Taken-At": ("Its `taken_at`.", "2026-01-02T03:04:05+00:00"),
    "Veilcam-Form": ("In which form it left.", "raw"),
    "Veilcam-Replay": ("Its place in a recording, where it comes from one.", "7"),
    "Veilcam-Replay-Capture": ("Which capture that was.", "c0ffee00"),
}
_ALWAYS = ("X-Request-Id", CALL_HEADER, RUN_HEADER, "Cache-Control")
_OF_ARRAYS = tuple(
    name
    for name in _HEADERS
    if name.startswith("Veilcam-") and name not in (*_ALWAYS, PADDING_HEADER)
)
(_EVENT,) = events.examples()
_TEXTS = {
    "text/plain": metrics.EXAMPLE,
    "text/event-stream": (
        f"event: {_EVENT.kind}\nid: {_EVENT.id}\ndata: {_EVENT.model_dump_json()}\n\n"
    ),
}
_EXAMPLES: Mapping[str, BaseModel] = {
    type(example).__name__: example
    for module in iter_modules(wire.__path__)
    for example in getattr(import_module(f"{wire.__name__}.{module.name}"), "examples", tuple)()
}
"""By the name of the model."""


def document(app: FastAPI, root_path: str = "") -> dict[str, Any]:
    """Return the document of ``app``, made once.

    Args:
        app: application with all routes.
        root_path: path under which a proxy shows the daemon.
    """
    made = app.openapi_schema is None
    found = app.openapi()
    if made:
        _add_problem(found)
        found["tags"] = [{"name": name, "description": about} for name, about in TAGS.items()]
        # Where the document comes from is where the API is.
        found["servers"] = [{"url": root_path or "/", "description": "This daemon."}]
        for path, operations in found["paths"].items():
            for method, operation in operations.items():
                _add_examples(operation)
                _add_headers(operation, padded=path in PATHS)
                operation["x-codeSamples"] = code_samples(
                    operation["operationId"], method.upper(), path, token="security" in operation
                )
    return found


def _add_problem(found: dict[str, Any]) -> None:
    schema = Problem.model_json_schema(ref_template=REF_PREFIX + "{model}", mode="serialization")
    schemas = found.setdefault("components", {}).setdefault("schemas", {})
    schemas.update(schema.pop("$defs"))
    schemas["Problem"] = schema


def _add_headers(operation: dict[str, Any], *, padded: bool) -> None:
    for status, answer in operation["responses"].items():
        names = [*_ALWAYS, PADDING_HEADER] if padded else [*_ALWAYS]
        codes = answer["description"].split(", ") if status >= "400" else []
        if any(code in PROBLEMS and PROBLEMS[code].retryable for code in codes):
            names.append("Retry-After")
        if status == "401":
            names.append("WWW-Authenticate")
        if "304" in operation["responses"] and status in ("200", "304"):
            names.append("ETag")
        if status == "200" and NPY_MEDIA_TYPE in answer.get("content", {}):
            names += _OF_ARRAYS
        if operation["tags"] == ["Session"] and status in ("201", "204"):
            names.append("Set-Cookie")
        answer["headers"] = {name: _header(name) for name in names}


def _header(name: str) -> dict[str, Any]:
    about, example = _HEADERS[name]
    return {"description": about, "schema": {"type": "string"}, "example": example}


def _add_examples(operation: dict[str, Any]) -> None:
    bodies = [operation.get("requestBody", {}), *operation["responses"].values()]
    for body in bodies:
        for media_type, content in body.get("content", {}).items():
            if media_type == PROBLEM_MEDIA_TYPE:
                examples = {code: example_of(code) for code in body["description"].split(", ")}
            elif media_type.startswith("text/"):
                content.setdefault("example", _TEXTS.get(media_type))
                continue
            else:
                examples = {
                    name: json.loads(_EXAMPLES[name].model_dump_json())
                    for name in _models(content.get("schema", {}))
                    if name in _EXAMPLES
                }
            if examples:
                content["examples"] = {name: {"value": value} for name, value in examples.items()}


def _models(schema: dict[str, Any]) -> Iterator[str]:
    """Names of the models that a schema allows."""
    if "$ref" in schema:
        yield schema["$ref"].removeprefix(REF_PREFIX)
    for choice in ("oneOf", "anyOf"):
        for one in schema.get(choice, ()):
            yield from _models(one)
