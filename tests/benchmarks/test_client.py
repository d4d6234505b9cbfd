"""Types of the SDK: what has none is counted and named."""

from __future__ import annotations

import json

import pytest
from benchmarks.client import types


def test_symbols_without_a_type_are_counted_and_named(capsys: pytest.CaptureFixture[str]) -> None:
    symbols = [
        {"name": "veilcam_client.known", "isExported": True, "isTypeKnown": True},
        {"name": "veilcam_client.unknown", "isExported": True, "isTypeKnown": False},
        {"name": "numpy.other", "isExported": False, "isTypeKnown": False},
    ]
    found = {"modules": [{"name": "veilcam_client"}], "completenessScore": 0.5, "symbols": symbols}
    assert types.completeness(json.dumps({"typeCompleteness": found})) == 50
    assert capsys.readouterr().out == "veilcam_client.unknown\n"
