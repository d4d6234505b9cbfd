"""The OpenAPI document: what FastAPI finds out, with problems and examples."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.constants import REF_PREFIX

from veilcam_client.wire.captures import PROBLEM_MEDIA_TYPE, Problem
from veilcam_server.api.examples import EVENTS, EXAMPLES, METRICS
from veilcam_server.api.problems import example_of

_TEXTS = {"text/plain": METRICS, "text/event-stream": EVENTS}


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
                codes = body["description"].split(", ")
                examples = {code: example_of(code) for code in codes}
            elif media_type in _TEXTS:
                content["example"] = _TEXTS[media_type]
                continue
            else:
                examples = {
                    name: json.loads(EXAMPLES[name].model_dump_json())
                    for name in _models(content.get("schema", {}))
                    if name in EXAMPLES
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
