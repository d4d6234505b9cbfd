"""The wire models: closed questions, open answers."""

from __future__ import annotations

import json
from typing import Any

import pytest
from pydantic import ValidationError
from tests.unit.client.conftest import STATUS

from veilcam_client.wire.captures import ClassificationRequest
from veilcam_client.wire.events import EVENT, EVENT_KINDS, Gap
from veilcam_client.wire.rotation import POLICY, EveryCaptures, EverySeconds, RotationOff
from veilcam_client.wire.status import Status


def test_answers_of_a_newer_server_can_be_read() -> None:
    assert Status.model_validate_json(json.dumps(STATUS)).version == "9.9"


@pytest.mark.parametrize(
    "policy",
    [
        RotationOff(),
        EverySeconds(seconds=5),
        EverySeconds(seconds=5, jitter=4.5, reuse=2),
        EveryCaptures(captures=2, reuse=3),
    ],
)
def test_policies_survive_the_wire(policy: RotationOff | EverySeconds | EveryCaptures) -> None:
    assert POLICY.validate_json(policy.model_dump_json()) == policy


@pytest.mark.parametrize("seconds", [0, 0.05, -1, float("nan"), float("inf"), 1e9])
def test_impossible_times_are_refused(seconds: float) -> None:
    with pytest.raises(ValidationError):
        EverySeconds(seconds=seconds)


@pytest.mark.parametrize("jitter", [-1.0, 5.0, 4.95, float("nan"), True])
def test_impossible_jitter_is_refused(jitter: Any) -> None:
    with pytest.raises(ValidationError):
        EverySeconds(seconds=5.0, jitter=jitter)


@pytest.mark.parametrize("captures", [0, -1, True, 1.0, 10**7])
def test_impossible_counts_are_refused(captures: Any) -> None:
    with pytest.raises(ValidationError):
        EveryCaptures(captures=captures)


def test_misspelt_questions_are_refused() -> None:
    with pytest.raises(ValidationError):
        ClassificationRequest.model_validate_json('{"include_embeding": true}')
    with pytest.raises(ValidationError):
        ClassificationRequest.model_validate_json('{"include_embedding": 1}')


def test_models_do_not_change() -> None:
    with pytest.raises(ValidationError):
        EverySeconds(seconds=1).seconds = 2


def test_every_kind_of_event_is_known() -> None:
    mapping = EVENT.json_schema()["discriminator"]["mapping"]
    assert set(mapping) == EVENT_KINDS
    text = '{"kind": "gap", "id": "a-1", "at": "2026-01-02T03:04:05Z", "missed": 3}'
    assert EVENT.validate_json(text) == Gap.model_validate_json(text)
