"""The OpenAPI document: examples for everything, and all of them valid."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
from jsonschema import Draft202012Validator  # type: ignore[import-untyped]

from veilcam_client.wire.problems import PROBLEM_MEDIA_TYPE
from veilcam_server.api.app import create_app
from veilcam_server.api.dependencies import ALWAYS, OPEN
from veilcam_server.api.openapi import document

if TYPE_CHECKING:
    from tests.server.conftest import Bench


BINARY = ("application/x-npy", "application/vnd.veilcam.bundle", "image/png", "image/jpeg")


@pytest.fixture
def found(bench: Bench) -> dict[str, Any]:
    app = create_app(bench.service(bench.camera()))
    made = document(app)
    assert document(app) is made
    return made


def bodies(found: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any], str]]:
    """Place, media type, content and description of every body asked for or answered with."""
    for path, operations in found["paths"].items():
        for method, operation in operations.items():
            asked = operation.get("requestBody", {})
            for media_type, content in asked.get("content", {}).items():
                yield f"{method} {path}", media_type, content, ""
            for status, answer in operation["responses"].items():
                for media_type, content in answer.get("content", {}).items():
                    place = f"{method} {path} {status}"
                    yield place, media_type, content, answer["description"]


def test_examples_are_there_and_valid(found: dict[str, Any]) -> None:
    checked = 0
    for place, media_type, content, description in bodies(found):
        if media_type in BINARY:
            continue
        if media_type.startswith("text/"):
            assert content["example"], place
            continue
        if place.startswith("get /v1/openapi.json 2"):
            continue
        examples = {name: each["value"] for name, each in content.get("examples", {}).items()}
        assert examples, f"{place} has no example: add one to EXAMPLES beside its model"
        if media_type == PROBLEM_MEDIA_TYPE:
            assert set(examples) == set(description.split(", "))
        validator = Draft202012Validator(
            {**content["schema"], "components": found["components"]},
            format_checker=Draft202012Validator.FORMAT_CHECKER,
        )
        for name, value in examples.items():
            assert not list(validator.iter_errors(value)), (place, name)
            checked += 1
    assert checked > 100


def test_every_route_has_a_summary_and_says_what_can_go_wrong(found: dict[str, Any]) -> None:
    for path, operations in found["paths"].items():
        for method, operation in operations.items():
            assert operation["description"].endswith("."), (method, path)
            documented = ", ".join(each["description"] for each in operation["responses"].values())
            expected = ALWAYS if "security" in operation else OPEN
            assert set(expected) <= set(documented.split(", ")), (method, path)


def test_every_reference_leads_somewhere(found: dict[str, Any]) -> None:
    references = set(re.findall(r"'\$ref': '([^']+)'", str(found)))
    assert references
    for reference in references:
        assert reference.startswith("#/components/schemas/")
        assert reference.rpartition("/")[2] in found["components"]["schemas"]


def test_request_examples_are_served(found: dict[str, Any]) -> None:
    asked = found["paths"]["/v1/rotation"]["put"]["requestBody"]["content"]["application/json"]
    assert set(asked["examples"]) == {"RotationOff", "EverySeconds", "EveryCaptures"}
