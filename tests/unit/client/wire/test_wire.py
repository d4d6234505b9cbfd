"""The wire models: closed questions, open answers."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError
from tests.unit.client.conftest import STATUS

from veilcam_client import events, models
from veilcam_client.wire.captures import ClassificationRequest
from veilcam_client.wire.events import EVENT, EVENT_KINDS, Gap
from veilcam_client.wire.pairing import Paired, PairingClaim
from veilcam_client.wire.rotation import POLICY, EveryCaptures, EverySeconds, RotationOff
from veilcam_client.wire.status import Status
from veilcam_client.wire.tokens import NewToken


def test_answers_of_a_newer_server_can_be_read() -> None:
    assert Status.model_validate_json(json.dumps(STATUS)).version == "9.9"


def test_policies_survive_the_wire() -> None:
    seconds = EverySeconds(seconds=5, jitter=4.5, reuse=2)
    captures = EveryCaptures(captures=2, reuse=3)
    for policy in (RotationOff(), EverySeconds(seconds=5), seconds, captures):
        assert POLICY.validate_json(policy.model_dump_json()) == policy


@pytest.mark.parametrize(
    ("kind", "given"),
    [
        *((EverySeconds, {"seconds": each}) for each in (0, 0.05, -1, math.nan, math.inf, 1e9)),
        *(
            (EverySeconds, {"seconds": 5.0, "jitter": each})
            for each in (-1.0, 5.0, 4.95, math.nan, True)
        ),
        *((EveryCaptures, {"captures": each}) for each in (0, -1, True, 1.0, 10**7)),
        (ClassificationRequest, {"include_embeding": True}),
        (ClassificationRequest, {"include_embedding": 1}),
    ],
)
def test_impossible_question_is_refused(kind: type[BaseModel], given: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        kind.model_validate(given)


@pytest.mark.parametrize("kind", [PairingClaim, Paired, NewToken])
def test_traceback_of_what_cannot_be_read_repeats_no_secret(kind: type[BaseModel]) -> None:
    for given in ({"secret": "s3cret"}, {"token": 1, "secret": ["s3cret"]}):
        with pytest.raises(ValidationError) as refused:
            kind.model_validate(given)
        assert "s3cret" not in str(refused.value)


def test_models_do_not_change() -> None:
    with pytest.raises(ValidationError):
        EverySeconds(seconds=1).seconds = 2


def test_every_kind_of_event_is_known() -> None:
    mapping = EVENT.json_schema()["discriminator"]["mapping"]
    assert set(mapping) == EVENT_KINDS
    text = '{"kind": "gap", "id": "a-1", "at": "2026-01-02T03:04:05Z", "missed": 3}'
    assert EVENT.validate_json(text) == Gap.model_validate_json(text)


UNITS = {"_s": "[s]", "_m": "[m]", "_hz": "[1/s]", "_rad": "[rad]"}
MODELS = [
    kind
    for module in (models, events)
    for kind in vars(module).values()
    if isinstance(kind, type) and issubclass(kind, BaseModel)
]


@pytest.mark.parametrize("kind", MODELS)
def test_every_field_is_described_with_its_unit(kind: type[BaseModel]) -> None:
    properties = kind.model_json_schema(mode="serialization")["properties"]
    assert set(properties) == set(kind.model_fields)
    for name, schema in properties.items():
        said = schema["description"]
        assert said.endswith("."), name
        for ending, unit in UNITS.items():
            assert not name.endswith(ending) or unit in said, name
