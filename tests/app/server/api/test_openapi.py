"""The OpenAPI document: examples for everything, and all of them valid."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
from jsonschema import Draft202012Validator  # type: ignore[import-untyped]
from tests.docs.api_reference import PAGE, page

from veilcam_client import Camera
from veilcam_client.resources import Resource
from veilcam_client.wire.base import PROBLEM_MEDIA_TYPE
from veilcam_client.wire.simulation import PICTURE_MEDIA_TYPES
from veilcam_server.api.app import create_app
from veilcam_server.api.dependencies import ALWAYS, OPEN
from veilcam_server.api.openapi import TAGS, document

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench


BINARY = ("application/x-npy", "application/vnd.veilcam.bundle", *PICTURE_MEDIA_TYPES)


@pytest.fixture
def found(bench: Bench) -> dict[str, Any]:
    app = create_app(bench.service(bench.camera()))
    made = document(app)
    assert document(app) is made
    return made


def operations(found: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for path, methods in found["paths"].items():
        for method, operation in methods.items():
            yield f"{method.upper()} {path}", operation


def bodies(found: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any], str]]:
    """Place, media type, content and description of every body asked for or answered with."""
    for name, operation in operations(found):
        for media_type, content in operation.get("requestBody", {}).get("content", {}).items():
            yield name, media_type, content, ""
        for status, answer in operation["responses"].items():
            for media_type, content in answer.get("content", {}).items():
                yield f"{name} {status}", media_type, content, answer["description"]


def test_examples_are_there_and_valid(found: dict[str, Any]) -> None:
    checked = 0
    for place, media_type, content, description in bodies(found):
        if media_type in BINARY:
            continue
        if media_type.startswith("text/"):
            assert content["example"], place
            continue
        if place.startswith("GET /v1/openapi.json 2"):
            continue
        examples = {name: each["value"] for name, each in content.get("examples", {}).items()}
        assert examples, f"{place} has no example: add one to examples() beside its model"
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
    for name, operation in operations(found):
        assert operation["description"].endswith("."), name
        documented = ", ".join(each["description"] for each in operation["responses"].values())
        expected = ALWAYS if "security" in operation else OPEN
        assert set(expected) <= set(documented.split(", ")), name


def test_every_reference_leads_somewhere(found: dict[str, Any]) -> None:
    references = set(re.findall(r"'\$ref': '([^']+)'", str(found)))
    assert references
    for reference in references:
        assert reference.startswith("#/components/schemas/")
        assert reference.rpartition("/")[2] in found["components"]["schemas"]


def test_request_examples_are_served(found: dict[str, Any]) -> None:
    asked = found["paths"]["/v1/rotation"]["put"]["requestBody"]["content"]["application/json"]
    assert set(asked["examples"]) == {"RotationOff", "EverySeconds", "EveryCaptures"}


def test_every_method_of_the_sdk_is_shown_with_its_operation(found: dict[str, Any]) -> None:
    ids = [operation["operationId"] for _, operation in operations(found)]
    assert len(set(ids)) == len(ids)
    shown = {
        each["source"].partition("(")[0] if "next(" not in each["source"] else "camera.events"
        for _, operation in operations(found)
        for each in operation["x-codeSamples"]
        if each["lang"] == "Python" and "camera." in each["source"]
    }
    camera = Camera("http://localhost")
    methods = {f"camera.{name}" for name in vars(Camera) if not name.startswith("_")}
    for name, each in vars(camera).items():
        if isinstance(each, Resource):
            methods |= {f"camera.{name}.{one}" for one in vars(type(each)) if one[0] != "_"}
    # What is no request of its own, or one of two ways to ask the same.
    other = ("close", "discover", "raw", "lease.hold", "lease.revoke")
    assert methods - shown == {f"camera.{name}" for name in other}
    assert shown <= methods


def test_page_of_operations_is_that_of_the_document(found: dict[str, Any]) -> None:
    assert PAGE.read_text() == page(found), "write it anew: python -m tests.docs.api_reference"


def test_every_operation_has_a_subject_and_every_subject_operations(found: dict[str, Any]) -> None:
    subjects = [subject for _, operation in operations(found) for subject in operation["tags"]]
    assert set(subjects) == {tag["name"] for tag in found["tags"]} == set(TAGS)
    assert len(subjects) == len(list(operations(found)))


def test_document_says_where_the_api_is_and_under_which_licence(found: dict[str, Any]) -> None:
    assert [server["url"] for server in found["servers"]] == ["/"]
    assert found["info"]["license"]["identifier"] == "Apache-2.0"


def test_headers_of_answers_are_documented(found: dict[str, Any]) -> None:
    headers = {
        (name, status): set(answer["headers"])
        for name, operation in operations(found)
        for status, answer in operation["responses"].items()
    }
    always = {"X-Request-Id", "Veilcam-Call", "Veilcam-Run", "Cache-Control"}
    assert all(always <= each for each in headers.values())
    assert headers["GET /v1/bundles", "200"] == headers["GET /v1/bundles", "304"]
    assert headers["GET /v1/bundles", "200"] == always | {"ETag"}
    assert headers["GET /v1/status", "200"] == always | {"Veilcam-Padding"}
    assert headers["GET /v1/status", "401"] == always | {"Veilcam-Padding", "WWW-Authenticate"}
    assert "Retry-After" in headers["POST /v1/captures", "503"]
    assert "Retry-After" not in headers["POST /v1/captures", "422"]
    assert "Veilcam-Epoch" in headers["POST /v1/captures", "200"]
    assert "Set-Cookie" in headers["POST /v1/session", "201"]
