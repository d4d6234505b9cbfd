"""A classifier of the clear part finds what was planted there, and nothing where nothing is."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from benchmarks.privacy.keys.clear_part import clear_part_gain, columns, differences
from benchmarks.privacy.keys.plant import Answer, two_scenes

COUNT = 150
Leak = Callable[[int, dict[str, Any], list[tuple[str, str]]], None]


def answers(leak: Leak | None = None) -> tuple[list[Answer], np.ndarray[Any, np.dtype[np.int64]]]:
    random = np.random.default_rng(1)
    labels = two_scenes(COUNT, seed=1)
    made = []
    for label in labels:
        body: dict[str, Any] = {
            "id": random.bytes(8).hex(),
            "epoch": random.bytes(16).hex(),
            "number": 0,
            "taken_at": f"2026-01-02T03:04:{random.integers(60):02}Z",
            "embedding": {"form": "raw", "values": [float(random.standard_normal())]},
        }
        headers = [("status", "200 OK"), ("x-request-id", random.bytes(8).hex())]
        if leak is not None:
            leak(label, body, headers)
        made.append(Answer(label, 0.1, tuple(headers), json.dumps(body)))
    return made, np.array(labels)


def value(label: int, body: dict[str, Any], headers: list[tuple[str, str]]) -> None:
    body["number"] = label


def header(label: int, body: dict[str, Any], headers: list[tuple[str, str]]) -> None:
    headers.append(("server-timing", f"total;dur={10 + label}"))


def digits(label: int, body: dict[str, Any], headers: list[tuple[str, str]]) -> None:
    body["epoch"] = f"{label}{body['epoch'][1:]}"


def test_answers_that_are_alike_differ_in_no_column() -> None:
    made, labels = answers()
    found = columns(made)
    assert differences(found, labels) == []
    assert {"epoch: value", "header x-request-id: byte 3", "byte 97: count"} <= found.keys()


@pytest.mark.slow
@pytest.mark.parametrize("leak", [value, digits])
def test_classifier_wins_on_a_leak(leak: Leak) -> None:
    made, labels = answers(leak)
    gain = clear_part_gain(columns(made), labels, epochs=4, seed=1)
    # Six standard errors: noise gives as much with a chance of 1e-9.
    assert gain.value > max(0.1, 6 * gain.error)
