"""The REST API over a whole application in this process."""

from __future__ import annotations

import asyncio
import io
import re
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from starlette.types import Message
from tests.unit.server.service.waiting import until

from veilcam_client.wire.base import PROBLEM_MEDIA_TYPE, Problem
from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_client.wire.captures import NPY_MEDIA_TYPE, Capture, Classification
from veilcam_client.wire.rotation import EveryCaptures, EverySeconds, Rotation
from veilcam_client.wire.status import Status
from veilcam_server.api.app import create_app
from veilcam_server.devices import DisplayError, SensorError
from veilcam_server.errors import PROBLEMS
from veilcam_server.security.admission import Admission

if TYPE_CHECKING:
    import httpx
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio

ROOT = Path(__file__).parents[4]
DOCS = ROOT / "docs" / "api.md"


def problem(answer: httpx.Response, code: str) -> Problem:
    """Check that ``answer`` is a complete problem of this code."""
    assert answer.headers["content-type"] == PROBLEM_MEDIA_TYPE
    found = Problem.model_validate_json(answer.content)
    assert found.code == code
    assert found.status == answer.status_code == PROBLEMS[code].status
    assert found.retryable == PROBLEMS[code].retryable
    assert found.type == f"urn:veilcam:problem:{code}"
    assert found.request_id == answer.headers["x-request-id"]
    assert "\n" not in found.detail
    return found


async def test_status(running: Running, bench: Bench) -> None:
    async with running() as client:
        answer = await client.get("/v1/status")
        status = Status.model_validate_json(answer.content)
    assert status.state == "ready"
    assert status.rotation.epoch == bench.epochs[0]
    assert status.bundle.pairs == 3
    assert status.queue.limit == 8
    assert status.experiment is None


async def test_capture_as_json_and_as_npy(running: Running, bench: Bench) -> None:
    bench.sensor.measurement = np.random.default_rng(0).random((4, 5), np.float32)
    async with running(settle=0.01) as client:
        answer = await client.post("/v1/captures")
        capture = Capture.model_validate_json(answer.content)
        npy = await client.post("/v1/captures", headers={"Accept": NPY_MEDIA_TYPE})
    assert answer.headers["cache-control"] == "no-store, no-transform"
    assert npy.headers["cache-control"] == "no-store"
    assert capture.epoch == bench.epochs[0]
    assert np.array_equal(np.asarray(capture), bench.sensor.measurement)
    assert capture.number == 0
    assert capture.notes is None
    assert npy.headers["content-type"] == NPY_MEDIA_TYPE
    assert npy.headers["veilcam-epoch"] == capture.epoch
    assert (npy.headers["veilcam-number"], npy.headers["veilcam-form"]) == ("1", "raw")
    assert npy.headers["veilcam-capture"] != capture.id
    assert np.array_equal(np.load(io.BytesIO(npy.content)), bench.sensor.measurement)


async def test_classification_is_what_the_pair_s_own_network_says(
    running: Running, bench: Bench
) -> None:
    bench.sensor.measurement = np.random.default_rng(0).random((4, 5), np.float32)
    labels = set()
    async with running(admission=Admission(full_scores=True)) as client:
        for _ in range(6):
            answer = await client.post("/v1/classifications", json={"include_embedding": True})
            result = Classification.model_validate_json(answer.content)
            index = bench.pair_shown()
            assert index is not None
            weights = bench.bundle.pairs[index].weights["0.weight"]
            logits = weights @ bench.sensor.measurement.ravel()
            assert result.label == bench.bundle.labels[int(np.argmax(logits))]
            assert result.scores is not None
            assert result.confidence == max(result.scores.values())
            assert sum(result.scores.values()) == pytest.approx(1)
            assert result.embedding is not None
            assert np.array_equal(np.asarray(result.embedding), bench.sensor.measurement)
            labels.add((index, result.label))
            await client.post("/v1/rotation/advance")
    assert len(labels) > 1


async def test_embedding_stays_inside_unless_asked_for(running: Running) -> None:
    async with running() as client:
        for body in (None, {}, {"include_embedding": False}):
            answer = await client.post("/v1/classifications", json=body)
            assert Classification.model_validate_json(answer.content).embedding is None


async def test_rotation_by_hand_and_by_captures(running: Running, bench: Bench) -> None:
    async with running() as client:
        first = Rotation.model_validate_json((await client.get("/v1/rotation")).content)
        assert first.policy.mode == "off"
        answer = await client.post("/v1/rotation/advance")
        second = Rotation.model_validate_json(answer.content)
        assert second.epoch == bench.epochs[1] != first.epoch
        answer = await client.put("/v1/rotation", json={"mode": "captures", "captures": 2})
        assert Rotation.model_validate_json(answer.content).policy == EveryCaptures(captures=2)
        epochs = [(await client.post("/v1/captures")).json()["epoch"] for _ in range(6)]
    assert [epochs.count(epoch) for epoch in dict.fromkeys(epochs)] == [2, 2, 2]


async def test_change_at_the_moment_of_closing_does_not_keep_the_service_open(
    bench: Bench,
) -> None:
    camera = bench.camera(policy=EverySeconds(seconds=60))
    service = bench.service(camera)
    async with asyncio.timeout(200):
        async with service.open():
            await asyncio.sleep(0.05)
            await service.set_policy(EveryCaptures(captures=2))
    assert camera.state[0] == "stopping"


async def test_mask_is_changed_before_somebody_waits_for_it(running: Running, bench: Bench) -> None:
    async with running(policy=EveryCaptures(captures=1)) as client:
        await client.post("/v1/captures")
        await until(lambda: len(bench.epochs) >= 2)
    assert len(bench.epochs) == 2


async def test_rotation_by_time_outlives_a_failing_panel(
    running: Running, bench: Bench, display_fault: DisplayError
) -> None:
    async with running() as client:
        bench.display.faults = [display_fault]
        await client.put("/v1/rotation", json={"mode": "seconds", "seconds": 0.1})
        await until(lambda: len(bench.epochs) >= 2)
    assert len(bench.epochs) >= 2


@pytest.mark.parametrize(
    "policy",
    [
        *({"mode": "seconds", "seconds": wrong} for wrong in (0, -1, True, "5")),
        {"mode": "seconds"},
        *({"mode": "captures", "captures": wrong} for wrong in (0, 1.5, False)),
        {"mode": "captures", "captures": 1, "jitter": 2},
        {"mode": "sometimes"},
        {},
        [],
        None,
    ],
)
async def test_bad_policy_is_refused_and_the_old_one_stays(running: Running, policy: Any) -> None:
    async with running(policy=EveryCaptures(captures=5)) as client:
        answer = await client.put("/v1/rotation", json=policy)
        assert problem(answer, "invalid_request").errors
        kept = Rotation.model_validate_json((await client.get("/v1/rotation")).content)
        assert kept.policy == EveryCaptures(captures=5)
        assert (await client.post("/v1/captures")).is_success


@pytest.mark.parametrize("body", [b"{", b'{"mode": "seconds", "seconds": Infinity}', b"\xff", b""])
async def test_body_that_is_no_json_is_refused(running: Running, body: bytes) -> None:
    async with running() as client:
        headers = {"Content-Type": "application/json"}
        answer = await client.put("/v1/rotation", content=body, headers=headers)
    assert answer.status_code in (400, 422)
    problem(answer, "bad_request" if answer.status_code == 400 else "invalid_request")


async def test_errors_of_the_protocol_are_problems(running: Running) -> None:
    async with running() as client:
        problem(await client.get("/v1/nothing"), "not_found")
        problem(await client.get("/v1/status/"), "not_found")
        wrong = await client.delete("/v1/status")
        problem(wrong, "method_not_allowed")
        assert wrong.headers["allow"] == "GET, HEAD"
        for method, path, headers, code in (
            ("POST", "/v1/captures", {"Accept": "image/png"}, "not_acceptable"),
            ("GET", "/v1/status", {"Host": "camera.example"}, "host_refused"),
            ("POST", "/v1/captures", {"Idempotency-Key": "x" * 200}, "invalid_request"),
        ):
            problem(await client.request(method, path, headers=headers), code)


@pytest.mark.parametrize("path", ["/v1/captures", "/v1/classifications", "/v1/rotation/advance"])
async def test_body_too_large_is_refused_whatever_it_claims(
    running: Running, bench: Bench, path: str
) -> None:
    async def stream() -> Any:
        for _ in range(40):
            yield b" " * 1024

    async with running() as client:
        for content in (b" " * 40_000, stream()):
            answer = await client.post(
                path, content=content, headers={"Content-Type": "application/json"}
            )
            problem(answer, "body_too_large")
    assert bench.sensor.captures == 0


@pytest.mark.parametrize("path", ["/v1/captures", "/v1/bundles", "/v1/simulation/scene"])
async def test_body_that_breaks_off_is_no_defect(
    bench: Bench, path: str, capsys: pytest.CaptureFixture[str]
) -> None:
    service = bench.service(bench.camera())
    app = create_app(service)
    messages: list[Message] = [
        {"type": "http.request", "body": b"PK", "more_body": True},
        {"type": "http.disconnect"},
    ]
    sent: list[Message] = []
    media_types = {"/v1/bundles": BUNDLE_MEDIA_TYPE, "/v1/simulation/scene": "image/png"}

    async def receive() -> Message:
        return messages.pop(0)

    async def send(message: Message) -> None:
        sent.append(message)

    scope = {
        "type": "http",
        "http_version": "1.1",
        "method": "PUT" if path.endswith("scene") else "POST",
        "path": path,
        "raw_path": path.encode(),
        "query_string": b"",
        "headers": [
            (b"host", b"localhost"),
            (b"content-type", media_types.get(path, "application/json").encode()),
            (b"content-length", b"1000"),
        ],
    }
    async with service.open():
        await app(scope, receive, send)
    assert not sent or sent[0]["status"] < 500
    log = capsys.readouterr()
    assert "defect" not in log.out + log.err
    assert bench.sensor.captures == 0


async def test_failing_sensor_is_a_problem_with_retry_after(running: Running, bench: Bench) -> None:
    def fail() -> None:
        raise SensorError("no frame came")

    async with running() as client:
        bench.sensor.before = fail
        answer = await client.post("/v1/captures")
        assert problem(answer, "sensor_failed").detail == "no frame came"
        assert int(answer.headers["retry-after"]) >= 1
        bench.sensor.before = lambda: None
        assert (await client.post("/v1/captures")).is_success


async def test_fence_display_and_safe_state_are_problems(
    running: Running, bench: Bench, display_fault: DisplayError
) -> None:
    async with running(settle=0.01) as client:
        bench.sensor.early = 0.005
        problem(await client.post("/v1/classifications"), "sensor_failed")
        bench.sensor.early = 0.0
        bench.display.faults = [display_fault, display_fault]
        problem(await client.post("/v1/rotation/advance"), "display_failed")
        problem(await client.post("/v1/captures"), "not_ready")
        status = Status.model_validate_json((await client.get("/v1/status")).content)
        assert status.state == "safe"
        assert status.rotation.epoch is None
        assert (await client.post("/v1/rotation/advance")).is_success
        assert (await client.post("/v1/captures")).is_success


async def test_one_pair_cannot_rotate(running: Running, lone_bench: Bench) -> None:
    async with running(on=lone_bench) as client:
        problem(await client.post("/v1/rotation/advance"), "conflict")
        answer = await client.put("/v1/rotation", json={"mode": "captures", "captures": 1})
        problem(answer, "conflict")
        assert (await client.post("/v1/captures")).is_success


async def test_full_queue_turns_requests_away(running: Running, bench: Bench) -> None:
    go_on = threading.Event()
    async with running(queue_limit=2) as client:
        bench.sensor.before = lambda: (go_on.wait(100), None)[1]
        waiting = [asyncio.create_task(client.post("/v1/captures")) for _ in range(2)]
        while (await client.get("/v1/status")).json()["queue"]["waiting"] < 2:
            await asyncio.sleep(0.01)
        refused = await client.post("/v1/captures")
        problem(refused, "queue_full")
        assert int(refused.headers["retry-after"]) >= 1
        problem(await client.post("/v1/rotation/advance"), "queue_full")
        go_on.set()
        assert all([(await task).is_success for task in waiting])
        assert (await client.post("/v1/captures")).is_success


async def test_repeated_key_is_answered_twice_and_done_once(running: Running, bench: Bench) -> None:
    key = {"Idempotency-Key": "one"}
    async with running() as client:
        first = await client.post("/v1/captures", headers=key)
        again = await client.post("/v1/captures", headers=key)
        assert again.content == first.content
        npy = await client.post("/v1/captures", headers={**key, "Accept": NPY_MEDIA_TYPE})
        assert npy.headers["veilcam-capture"] == first.json()["id"]
        assert bench.sensor.captures == 1
        other = await client.post("/v1/classifications", headers=key)
        problem(other, "idempotency_key_reused")
        assert (await client.post("/v1/captures")).json()["id"] != first.json()["id"]


async def test_repeated_key_in_parallel_is_done_once(running: Running, bench: Bench) -> None:
    async with running() as client:
        answers = await asyncio.gather(
            *(client.post("/v1/rotation/advance", headers={"Idempotency-Key": "k"}) for _ in "1234")
        )
    assert len({answer.json()["epoch"] for answer in answers}) == 1
    assert len(bench.epochs) == 2


async def test_defect_is_a_problem_that_tells_nothing(
    running: Running, bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise RuntimeError("levels were [1, 2, 3]")

    async with running(raising=False) as client:
        bench.sensor.before = fail
        answer = await client.post("/v1/captures", headers={"X-Request-Id": "abc-1"})
        found = problem(answer, "internal_error")
        bench.sensor.before = lambda: None
        assert (await client.post("/v1/captures")).is_success
    assert found.request_id == "abc-1"
    printed = "".join(capsys.readouterr())
    assert "abc-1" in printed
    assert "levels were" not in printed + answer.text


async def test_no_pattern_leaves(
    running: Running, bench: Bench, capsys: pytest.CaptureFixture[str], display_fault: DisplayError
) -> None:
    left = ""
    async with running(policy=EveryCaptures(captures=1), raising=False) as client:
        for fault in (None, display_fault, RuntimeError(str(bench.bundle.pairs[0].levels))):
            for path in ("captures", "classifications", "rotation/advance"):
                bench.display.faults = [fault, fault]
                left += (await client.post(f"/v1/{path}")).text
            for path in ("status", "rotation", "openapi.json", "nothing"):
                left += (await client.get(f"/v1/{path}")).text
    left += "".join(capsys.readouterr())
    assert '"embedding":{' in left
    numbers = " ".join(re.findall(r"\d+", left))
    for pair in bench.bundle.pairs:
        for row in pair.levels:
            assert " ".join(str(level) for level in row) not in numbers
        for weight in pair.weights["0.weight"].flatten().tolist():
            assert repr(abs(weight))[:12] not in left


async def test_request_id_is_taken_over_only_when_harmless(running: Running) -> None:
    async with running() as client:
        for asked, kept in (("my-id.7", True), ("a" * 65, False), ("with space", False)):
            answer = await client.get("/v1/status", headers={"X-Request-Id": asked})
            assert (answer.headers["x-request-id"] == asked) is kept


async def test_every_route_documents_its_problems_and_nobody_phones_home(running: Running) -> None:
    async with running() as client:
        schema = (await client.get("/v1/openapi.json")).json()
        assert (await client.get("/redoc")).status_code == 404
    for path, methods in schema["paths"].items():
        for method, operation in methods.items():
            assert "500" in operation["responses"], (method, path)
    # Those of the samples lead to the daemon's own address.
    assert set(re.findall(r"https?://[^/\s\"']*", str(schema))) == {"http://127.0.0.1:8787"}


def test_every_problem_code_is_documented_and_no_other() -> None:
    documented = set(re.findall(r"^\| `([a-z_]+)` \| \d{3} \|", DOCS.read_text(), re.MULTILINE))
    assert documented == set(PROBLEMS)


def test_codes_are_few_and_each_one_that_is_raised_is_in_the_table() -> None:
    sources = "".join(path.read_text() for path in ROOT.glob("server/**/*.py"))
    raised = set(re.findall(r'ProblemError\(\s*"([a-z_]+)"|\bcode="([a-z_]+)"', sources))
    assert {first or second for first, second in raised} - {"unauthorized"} <= set(PROBLEMS)
    assert len(raised) > 20
    assert len(PROBLEMS) <= 34


def test_every_route_is_documented(bench: Bench) -> None:
    paths = create_app(bench.service(bench.camera())).openapi()["paths"]
    text = DOCS.read_text()
    for path, methods in paths.items():
        for method in methods:
            assert f"`{method.upper()} {path}`" in text
