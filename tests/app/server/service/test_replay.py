"""A recording in the place of a camera: all of it, once, and never as if it were live."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from tests.app.server.conftest import asking
from tests.unit.client.recordings import AT, STATUS, VERDICT, Daemon, answer
from tests.unit.client.sealing import NOTES, VALUES
from tests.unit.client.sealing import Device as SealingDevice
from tests.unit.client.sealing import Epoch as SealedEpoch

from veilcam_client import AsyncCamera
from veilcam_client.cli.format import event_in_words
from veilcam_client.errors import ApiError, SealedError
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.models import Capture, Classification, EveryCaptures, RotationOff
from veilcam_client.recording import record
from veilcam_client.wire.bundles import BundleInfo
from veilcam_client.wire.events import CaptureTaken, Classified, Event
from veilcam_client.wire.watch import WatchOff
from veilcam_server.cli.terminal import one_line
from veilcam_server.daemon import build_service
from veilcam_server.errors import StartError
from veilcam_server.service.service import Service
from veilcam_server.settings import Settings

pytestmark = pytest.mark.anyio
COUNT = 3


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "recording.jsonl"
    record(Daemon().camera(), path, count=COUNT, labels=True)
    return path


def service_of(replay: Path) -> Service:
    given = {"replay": replay, "state_dir": replay.parent / "state"}
    return build_service(Settings.model_validate(given))


@asynccontextmanager
async def camera(path: Path) -> AsyncIterator[AsyncCamera]:
    async with (
        asking(service_of(path)) as http,
        AsyncCamera("http://localhost", http_client=http, max_retries=0) as sdk,
    ):
        yield sdk


async def code(asked: Any) -> str:
    with pytest.raises(ApiError) as caught:
        await asked
    assert caught.value.status == 409
    return caught.value.code


async def test_everything_comes_once_as_it_was_recorded_and_says_so(path: Path) -> None:
    async with camera(path) as sdk:
        first = await sdk.capture()
        second = await sdk.classify(include_embedding=True)
        third = await sdk.classify()
        assert third.embedding is None
        assert await code(sdk.capture()) == await code(sdk.classify()) == "not_enabled"
        assert (await sdk.status()).detail == f"3 of 3 captures recorded on {today(path)}"
    answers: tuple[Capture | Classification, ...] = (first, second, third)
    for place, taken in enumerate(answers):
        recorded = answer(place)
        told = taken.epoch, taken.taken_at.isoformat(), taken.number, taken.notes
        assert told == (recorded["epoch"], recorded["taken_at"], recorded["number"], None)
        assert taken.replay is not None
        assert taken.replay.model_dump() == {"capture": recorded["id"], "place": place}
        assert taken.id != recorded["id"]
    values = np.asarray(answer(0)["embedding"]["values"], np.float32).reshape(2, 3)
    assert np.array_equal(np.asarray(first), values)
    assert second.embedding is not None
    assert np.array_equal(np.asarray(second.embedding), values + 1)
    verdict = {"label": second.label, "confidence": second.confidence, "scores": second.scores}
    tenths = {label: round(score, 1) for label, score in VERDICT["scores"].items()}
    assert verdict == {**VERDICT, "confidence": round(VERDICT["confidence"], 1), "scores": tenths}


def today(path: Path) -> str:
    header: dict[str, str] = json.loads(path.read_text().splitlines()[0])
    return header["recorded_at"][:10]


async def test_array_alone_says_so_too(path: Path) -> None:
    async with asking(service_of(path)) as http:
        await http.post("/v1/captures")
        taken = await http.post("/v1/captures", headers={"Accept": "application/x-npy"})
    assert taken.headers["Veilcam-Replay"] == "1"
    assert taken.headers["Veilcam-Epoch"] == answer(1)["epoch"]
    assert taken.headers["Veilcam-Number"] == "0"


async def test_status_never_says_ready(path: Path) -> None:
    async with camera(path) as sdk:
        status = await sdk.status()
        assert status.state == "replay"
        assert status.device.display == "replay of ST7735R"
        assert status.device.sensor == "replay of IMX477"
        assert status.bundle == BundleInfo.model_validate_json(json.dumps(STATUS["bundle"]))
        assert (status.release, status.raw_budget, status.receivers) == ("raw", 0, ())
        assert status.device.key == "d7" * 32
        assert status.rotation.epoch is None
        assert status.rotation.policy == RotationOff()
        states = (await sdk.diagnostics()).states
        assert [each.state for each in states] == ["replay"]


async def test_masks_do_not_change_and_nothing_else_either(path: Path) -> None:
    async with camera(path) as sdk:
        for asked in (
            *(sdk.rotation.advance(), sdk.rotation.set(EveryCaptures(captures=1))),
            *(sdk.watch.get(), sdk.watch.set(WatchOff()), sdk.bundles.list(), sdk.receivers.list()),
            sdk.receivers.add("a", ReceiverKey.generate().public),
            *(sdk.receivers.remove("0f" * 32), sdk.bundles.install(b"bundle")),
            *(sdk.bundles.activate("0f" * 32), sdk.bundles.remove("0f" * 32)),
        ):
            assert await code(asked) == "not_enabled"
        assert await code(sdk.calibration.start()) == "calibration_impossible"
        assert await code(sdk.simulation.hold_scene(None)) == "not_enabled"
        assert (await sdk.rotation.get()).epoch is None
        assert (await sdk.status()).captures == 0
        assert not (await sdk.diagnostics()).faults
        # What was refused took nothing out of the recording.
        assert (await sdk.capture()).epoch == answer(0)["epoch"]


async def test_events_say_that_they_tell_of_a_replay(path: Path) -> None:
    service = service_of(path)
    async with service.open():
        events = service.events(None)
        assert await anext(events) is None
        await service.classify(include_embedding=False)
        told: list[Event] = []
        while len(told) < 2:
            if (event := await anext(events)) is not None:
                told.append(event)
    assert [type(event) for event in told] == [CaptureTaken, Classified]
    for event in told:
        assert isinstance(event, (CaptureTaken, Classified))
        assert event.replay
        assert "replay" in event_in_words(event)


async def test_no_route_answers_as_a_camera_would(path: Path) -> None:
    """Every operation, asked plainly: what is documented, and never that it is ready."""
    async with asking(service_of(path)) as http:
        document = (await http.get("/v1/openapi.json")).json()
        for route, operations in document["paths"].items():
            for method, operation in operations.items():
                if route == "/v1/events":
                    continue
                url = route.replace("{digest}", "0f" * 32).replace("{token_id}", "0" * 12)
                url = url.replace("{receiver_id}", "0f" * 32)
                given = await http.request(method, url)
                place = f"{method} {route}: {given.status_code}"
                assert str(given.status_code) in operation["responses"], place
                assert given.status_code < 500, place
                if route != "/v1/openapi.json":  # full of examples of a camera
                    assert '"state":"ready"' not in given.text, place


async def test_without_labels_there_is_nothing_to_classify(tmp_path: Path) -> None:
    path = tmp_path / "bare.jsonl"
    record(Daemon().camera(), path, count=1)
    async with camera(path) as sdk:
        assert await code(sdk.classify()) == "not_enabled"


async def test_sealed_recording_comes_sealed_and_its_receiver_opens_it(tmp_path: Path) -> None:
    key, path = ReceiverKey.generate(), tmp_path / "sealed.jsonl"
    epoch = SealedEpoch(SealingDevice(), key)
    daemon = Daemon(answers=lambda number: json.loads(epoch.capture(number).model_dump_json()))
    record(daemon.camera(), path, count=3)
    async with camera(path) as sdk:
        assert (await sdk.status()).release == "sealed"
        with pytest.raises(SealedError, match="key="):
            np.asarray(await sdk.capture())
    async with (
        asking(service_of(path)) as http,
        AsyncCamera("http://localhost", http_client=http, key=key) as sdk,
    ):
        first, second = await sdk.capture(), await sdk.capture()
        assert np.array_equal(np.asarray(first), VALUES)
        assert (first.number, second.number, second.notes) == (0, 1, NOTES)
        assert first.replay is not None
        refused = await http.post("/v1/captures", headers={"Accept": "application/x-npy"})
        assert refused.json()["code"] == "not_acceptable"


async def test_scores_are_told_as_far_as_they_were_recorded(tmp_path: Path) -> None:
    path = tmp_path / "recording.jsonl"
    record(Daemon().camera(), path, count=1, labels=True)
    header, line = path.read_text().splitlines()
    recorded = json.loads(line)
    recorded["verdict"] |= {"confidence": None, "scores": None}
    path.write_text(f"{header}\n{json.dumps(recorded)}\n")
    async with camera(path) as sdk:
        found = await sdk.classify()
    assert (found.label, found.confidence, found.scores) == (VERDICT["label"], None, None)


async def test_recording_a_replay_is_refused_by_what_is_read(path: Path, tmp_path: Path) -> None:
    """Whoever writes down what a replay answers gets no recording of it."""
    async with asking(service_of(path)) as http:
        status, taken = await http.get("/v1/status"), await http.post("/v1/captures")
    header = {"recorded_at": AT.isoformat(), "status": status.json()}
    header |= {"format": "veilcam-recording", "version": 1}
    again = tmp_path / "again.jsonl"
    lines = (header, {"capture": taken.json()})
    again.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(StartError, match="line 2: this was itself replayed"):
        service_of(again)


def test_recording_that_cannot_be_replayed_is_refused_at_the_start(path: Path) -> None:
    with pytest.raises(StartError, match="cannot be read"):
        service_of(path.with_name("missing"))
    service = service_of(path)
    with pytest.raises(StartError, match="another veilcamd uses"):
        service_of(path)
    service.stop()
    assert service.status().state == "stopping"
    service_of(path).stop()


@pytest.mark.parametrize(
    ("given", "option"),
    [
        ({"device": "simulated"}, "--simulate"),
        ({"bundle": "a.veilcam"}, "--bundle"),
        ({"scenes": ("a.png",)}, "--scenes"),
        ({"rotation": {"mode": "off"}}, "--every-seconds, --every-captures and --rotation-off"),
        ({"release": "raw"}, "--release"),
        ({"wrong_classifier": True}, "--wrong-classifier"),
        ({"panel_tab": "green"}, "--panel-tab"),
        ({"settle": 0.1}, "--settle"),
    ],
)
def test_recording_is_played_as_it_is(given: dict[str, Any], option: str) -> None:
    with pytest.raises(ValidationError) as caught:
        Settings.model_validate({"replay": "recording.jsonl", **given})
    assert f"leave out {option}" in one_line(caught.value)


def test_recording_wants_tokens_and_may_be_limited() -> None:
    made = Settings.model_validate({"replay": "recording.jsonl", "port": 0, "callers": 3})
    assert made.auth == "tokens"
    assert made.redacted()["replay"] == "given"
