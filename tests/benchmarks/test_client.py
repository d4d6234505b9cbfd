"""The benchmarks of the SDK, made short; and that they would notice a failure."""

from __future__ import annotations

import json

import pytest
from benchmarks.client import deadline, imports, overhead, types
from benchmarks.client.hostile import KINDS, Hostile, draw

from veilcam_client import Camera


def test_both_forms_are_served_and_measured(capsys: pytest.CaptureFixture[str]) -> None:
    with overhead.server() as url:
        with Camera(url) as camera, Camera(f"{url}/json") as other:
            assert camera.with_raw_response.capture().headers["content-type"] == "application/x-npy"
            assert other.with_raw_response.capture().headers["content-type"] == "application/json"
            assert camera.capture() == other.capture()
            assert camera.classify().label == "7"
        overhead.overhead(url, 2)
        overhead.arrays(url, 2)
    assert "bare httpx" in capsys.readouterr().out


def test_servers_are_drawn_again_the_same() -> None:
    assert draw(100, 3) == draw(100, 3) != draw(100, 4)
    assert {server.kind for server in draw(100, 3)} == set(KINDS)


def test_a_late_call_is_not_kept() -> None:
    server = Hostile("silent", deadline=0.4, pause=0.01, secure=False)
    assert deadline.kept(server, 0.449)
    assert not deadline.kept(server, 0.451)
    assert not deadline.kept(Hostile("silent", 2.0, 0.01, secure=False), 2.21)


@pytest.mark.slow
def test_an_import_takes_its_time() -> None:
    assert imports.processor_time("sum(range(10**7))") > imports.processor_time("pass")


def test_what_has_no_type_is_counted_and_named(capsys: pytest.CaptureFixture[str]) -> None:
    symbols = [
        {"name": "veilcam_client.known", "isExported": True, "isTypeKnown": True},
        {"name": "veilcam_client.unknown", "isExported": True, "isTypeKnown": False},
        {"name": "numpy.other", "isExported": False, "isTypeKnown": False},
    ]
    found = {"modules": [{"name": "veilcam_client"}], "completenessScore": 0.5, "symbols": symbols}
    assert types.completeness(json.dumps({"typeCompleteness": found})) == 50
    assert capsys.readouterr().out == "veilcam_client.unknown\n"


def test_an_sdk_that_is_not_there_is_no_zero() -> None:
    found = {"modules": [], "completenessScore": 0, "symbols": []}
    with pytest.raises(SystemExit, match="found no veilcam_client"):
        types.completeness(json.dumps({"typeCompleteness": found}))
