"""The benchmarks of the SDK, made short; and that they would notice a failure."""

from __future__ import annotations

import json

import pytest
from benchmarks.client import overhead, types

from veilcam_client import Camera


def test_overhead_of_both_forms_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    with overhead.server() as url:
        with Camera(url) as camera, Camera(f"{url}/json") as other:
            assert camera.raw(camera.capture).headers["content-type"] == "application/x-npy"
            assert other.raw(other.capture).headers["content-type"] == "application/json"
            assert camera.capture() == other.capture()
            assert camera.classify().label == "7"
        overhead.overhead(url, 2)
        overhead.arrays(url, 2)
    assert "bare httpx" in capsys.readouterr().out


def test_symbols_without_a_type_are_counted_and_named(capsys: pytest.CaptureFixture[str]) -> None:
    symbols = [
        {"name": "veilcam_client.known", "isExported": True, "isTypeKnown": True},
        {"name": "veilcam_client.unknown", "isExported": True, "isTypeKnown": False},
        {"name": "numpy.other", "isExported": False, "isTypeKnown": False},
    ]
    found = {"modules": [{"name": "veilcam_client"}], "completenessScore": 0.5, "symbols": symbols}
    assert types.completeness(json.dumps({"typeCompleteness": found})) == 50
    assert capsys.readouterr().out == "veilcam_client.unknown\n"
