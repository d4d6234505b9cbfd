"""The OpenAPI document: what FastAPI finds out, with problems and examples."""

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
from veilcam_client.wire.problems import PROBLEM_MEDIA_TYPE, Problem
from veilcam_server.api import metrics
from veilcam_server.api.problems import example_of

_EVENT = events.EXAMPLE
_TEXTS = {
    "text/plain": metrics.EXAMPLE,
    "text/event-stream": (
        f"event: {_EVENT.kind}\nid: {_EVENT.id}\ndata: {_EVENT.model_dump_json()}\n\n"
    ),
}
_EXAMPLES: Mapping[str, BaseModel] = {
    type(example).__name__: example
    for module in iter_modules(wire.__path__)
    for example in getattr(import_module(f"{wire.__name__}.{module.name}"), "EXAMPLES", ())
}
"""By the name of the model."""


def document(app: FastAPI) -> dict[str, Any]:
    """Return the document of ``app``, made once."""
    made = app.openapi_schema is None
    found = app.openapi()
    if made:
        _add_problem(found)
        for path in found["paths"].values():
            for operation in path.values():
                _add_examples(operation)
    return found


def _add_problem(found: dict[str, Any]) -> None:
    schema = Problem.model_json_schema(ref_template=REF_PREFIX + "{model}", mode="serialization")
    schemas = found.setdefault("components", {}).setdefault("schemas", {})
    schemas.update(schema.pop("$defs"))
    schemas["Problem"] = schema


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
