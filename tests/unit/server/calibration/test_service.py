"""A calibration asked for over the API: one at a time, undisturbed, and wholly or not at all."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import numpy as np
import pytest

from veilcam_client.wire.calibration import (
    CalibrationRun,
    CalibrationStatus,
    Quantity,
    SceneName,
    SignedCalibration,
)
from veilcam_client.wire.captures import Capture
from veilcam_client.wire.status import Status
from veilcam_client.wire.tokens import Scope
from veilcam_server.calibration.measurements import Budget
from veilcam_server.calibration.procedure import Calibrated, CancelledError, Run
from veilcam_server.calibration.record import open_calibration
from veilcam_server.calibration.rig import CalibrationScene, dark, lamp, white
from veilcam_server.calibration.service import CalibrationService
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.devices import Device, DisplayError
from veilcam_server.errors import CalibrationError, ProblemError
from veilcam_server.masks.source import MaskSource
from veilcam_server.sealing.identity import DeviceKey
from veilcam_server.security.admission import Admission
from veilcam_server.security.tokens import TokenStore

from .test_record import geometry_of, make_record, settings_for

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio
SCENES: tuple[SceneName, ...] = ("dark", "white card", "lamp")
READS = 4
"""Of each scene."""


class Measuring(CalibrationService):
    """Asks for scenes and exposes as a real one does, and finds what it is told to find."""

    def __init__(self, bench: Bench) -> None:
        bundle = bench.bundle
        settings = settings_for(bench.state_dir)
        super().__init__(settings, bundle, DeviceKey.open(settings.state_dir))
        self.scene = bundle.scene
        self.found = make_record(
            geometry=geometry_of(bundle),
            exposure_s=self._settings.exposure,
            settling_s=Quantity(value=0.02, uncertainty=0.01, residual=0.0),
        )
        self.before_measurement: Callable[[], None] = lambda: None
        self.fault: Exception | None = None

    def begin(self, repeats: int, report: Callable[[CalibrationRun], None]) -> Run:
        begun = super().begin(repeats, report)
        self._run = Run(begun.budget, repeats * READS * len(SCENES), report)
        return self._run

    def measure(self, device: Device, run: Run) -> Calibrated:
        for wanted in (dark(self.scene), white(self.scene), lamp(self.scene)):
            run.wait_for(wanted)
            for _ in range(run.budget.repeats * READS):
                self.before_measurement()
                device.display.show(np.zeros((9, 5), np.uint8))
                device.sensor.capture(0.0, 1.0)
                run.advance()
        run.enter("fitting")
        return Calibrated(self.found, None)  # type: ignore[arg-type]

    def write(self, signed: SignedCalibration) -> None:
        if self.fault is not None:
            raise self.fault
        super().write(signed)

    def written(self) -> SignedCalibration | None:
        return open_calibration(
            self._settings, self._bundle, DeviceKey.open(self._settings.state_dir)
        )


@pytest.fixture
def service(bench: Bench) -> Measuring:
    made = Measuring(bench)
    bench.calibration = made
    return made


async def status(client: httpx.AsyncClient) -> CalibrationStatus:
    return CalibrationStatus.model_validate_json((await client.get("/v1/calibration")).content)


async def until(
    client: httpx.AsyncClient, wanted: Callable[[CalibrationRun], bool]
) -> CalibrationRun:
    async with asyncio.timeout(200):
        while True:
            run = (await status(client)).run
            assert run is not None
            if wanted(run):
                return run
            await asyncio.sleep(0.005)


def waits_for(scene: str) -> Callable[[CalibrationRun], bool]:
    return lambda run: run.stage == "waiting" and run.scene == scene


def ended(run: CalibrationRun) -> bool:
    return run.stage in ("done", "failed", "cancelled")


async def present(client: httpx.AsyncClient, scene: str) -> httpx.Response:
    return await client.post("/v1/calibration/scene", json={"scene": scene})


async def start(client: httpx.AsyncClient, **asked: Any) -> httpx.Response:
    return await client.post("/v1/calibration", json=asked or None)


async def measured(client: httpx.AsyncClient, **asked: Any) -> CalibrationRun:
    """From the beginning to the end."""
    assert (await start(client, **asked)).status_code == 202
    for scene in SCENES:
        here = waits_for(scene)
        await until(client, lambda run: ended(run) or here(run))  # noqa: B023 - used at once
        if (await present(client, scene)).is_error:
            break
    return await until(client, ended)


async def state(client: httpx.AsyncClient) -> str:
    return Status.model_validate_json((await client.get("/v1/status")).content).state


async def measurement(client: httpx.AsyncClient) -> Capture:
    return Capture.model_validate_json((await client.post("/v1/captures")).content)


async def test_calibration_is_used_from_then_on(
    running: Running, bench: Bench, service: Measuring, monkeypatch: pytest.MonkeyPatch
) -> None:
    settled: list[float] = []
    adopt = MaskedCamera.adopt

    def noted(
        camera: MaskedCamera, calibration: SignedCalibration, settle: float, source: MaskSource
    ) -> None:
        settled.append(settle)
        adopt(camera, calibration, settle, source)

    monkeypatch.setattr(MaskedCamera, "adopt", noted)
    async with running() as client:
        assert await status(client) == CalibrationStatus(signed=None, run=None)
        assert np.asarray(await measurement(client)) == pytest.approx(1.0)
        tests = bench.test.runs
        run = await measured(client, repeats=1)
        assert (run.stage, run.exposures, run.total, run.detail) == ("done", 12, 12, None)
        assert (run.scene, run.instruction) == (None, None)
        assert await state(client) == "ready"
        assert bench.test.runs == tests + 1
        after = await measurement(client)
        assert np.asarray(after) == pytest.approx((1 - 0.02) / 0.5)
        assert settled == [0.03]
        assert bench.pair_shown() is not None
        found = await status(client)
        assert found.signed is not None
        assert service.written() == found.signed
        counted = (await client.get("/v1/diagnostics")).json()
        assert counted["events"]["calibration"] > 6
        assert "calibrating" in [past["state"] for past in counted["states"]]


async def test_calibration_is_disturbed_by_nobody(
    running: Running, bench: Bench, service: Measuring
) -> None:
    async with running() as client:
        assert (await start(client)).json()["total"] == 2 * READS * len(SCENES)
        run = await until(client, waits_for("dark"))
        assert run.instruction is not None
        assert "Cover the camera" in run.instruction
        assert await state(client) == "calibrating"
        captures = bench.sensor.captures
        for path in ("/v1/captures", "/v1/classifications", "/v1/rotation/advance"):
            answer = await client.post(path)
            assert (answer.status_code, answer.json()["code"]) == (503, "not_ready")
            assert answer.headers["retry-after"]
        again = await start(client)
        assert (again.status_code, again.json()["code"]) == (503, "not_ready")
        for scene in ("lamp", "white card"):
            answer = await present(client, scene)
            assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
            assert "'dark'" in answer.json()["detail"]
        assert (await present(client, "a tree")).status_code == 422
        assert bench.sensor.captures == captures
        assert np.array_equal(bench.display.shown[-1], np.zeros((9, 5)))
        assert (await client.delete("/v1/calibration")).json()["stage"] == "cancelled"


async def test_calibration_can_be_cancelled_while_it_waits_and_while_it_reads(
    running: Running, bench: Bench, service: Measuring
) -> None:
    reads = threading.Event()
    async with running() as client:
        for at_once in (True, False):
            await start(client)
            await until(client, waits_for("dark"))
            if not at_once:
                service.before_measurement = reads.set
                await present(client, "dark")
                await asyncio.to_thread(reads.wait, 10)
            ended_as = (await client.delete("/v1/calibration")).json()
            assert (ended_as["stage"], ended_as["detail"]) == ("cancelled", None)
            assert await state(client) == "ready"
            assert np.asarray(await measurement(client)) == pytest.approx(1.0)
            again = await client.delete("/v1/calibration")
            assert (again.status_code, again.json()["code"]) == (409, "conflict")
            assert (await present(client, "dark")).json()["code"] == "conflict"
        assert (await status(client)).signed is None
        assert service.written() is None


@pytest.mark.parametrize(
    ("fault", "detail"),
    [
        (CalibrationError("too little light: light it"), "too little light: light it"),
        (DisplayError("the bus gave no answer"), "the bus gave no answer"),
        (ZeroDivisionError("secret words"), "the daemon has a defect: nothing was changed"),
    ],
)
async def test_failure_changes_nothing(
    running: Running, service: Measuring, fault: Exception, detail: str
) -> None:
    def fail() -> None:
        raise fault

    service.before_measurement = fail
    async with running() as client:
        run = await measured(client)
        assert (run.stage, run.detail) == ("failed", detail)
        assert (await status(client)).signed is None
        assert await state(client) == "ready"
        assert np.asarray(await measurement(client)) == pytest.approx(1.0)


async def test_calibration_that_cannot_be_kept_is_not_used(
    running: Running, service: Measuring
) -> None:
    service.fault = CalibrationError("the disk is full: check it")
    async with running() as client:
        run = await measured(client)
        assert (run.stage, run.detail) == ("failed", "the disk is full: check it")
        assert (await status(client)).signed is None
        assert np.asarray(await measurement(client)) == pytest.approx(1.0)
        service.fault = None
        assert (await measured(client)).stage == "done"
        assert np.asarray(await measurement(client)) == pytest.approx(1.96)


@pytest.mark.slow
async def test_panel_that_fails_afterwards_is_told_by_the_state(
    running: Running, bench: Bench, service: Measuring
) -> None:
    async with running() as client:
        await start(client)
        await until(client, waits_for("dark"))
        bench.test.faults = [DisplayError("the bus gave no answer")]
        assert (await client.delete("/v1/calibration")).json()["stage"] == "cancelled"
        # It may be tried again, and be well, before anybody asks.
        assert ("safe", "the bus gave no answer") in bench.states
        async with asyncio.timeout(200):
            while await state(client) != "ready":
                await asyncio.sleep(0.05)


async def test_daemon_that_stops_waits_for_no_scene(
    running: Running, bench: Bench, service: Measuring
) -> None:
    async with running() as client, asyncio.timeout(200):
        await start(client)
        await until(client, waits_for("dark"))
    assert np.array_equal(bench.display.shown[-1], np.zeros((9, 5)))
    assert bench.display.closed


async def test_recording_cannot_be_calibrated(running: Running) -> None:
    async with running() as client:
        answer = await start(client)
        assert (answer.status_code, answer.json()["code"]) == (409, "calibration_impossible")


@pytest.fixture
def store(tmp_path: Path) -> TokenStore:
    return TokenStore(tmp_path / "state")


async def test_calibration_wants_its_scope_and_that_nobody_else_holds_the_camera(
    running: Running, service: Measuring, store: TokenStore
) -> None:
    def headers(*scopes: Scope) -> dict[str, str]:
        return {"Authorization": "Bearer " + store.create("x", scopes, None).secret}

    may, other = headers("calibrate", "mask:rotate"), headers("mask:rotate", "classify")
    async with running(admission=Admission(tokens=store)) as client:
        for method, path, body in (
            ("POST", "/v1/calibration", None),
            ("POST", "/v1/calibration/scene", {"scene": "dark"}),
            ("DELETE", "/v1/calibration", None),
        ):
            answer = await client.request(method, path, json=body, headers=other)
            assert answer.status_code == 403, path
        lease = {"owner": "an experiment", "seconds": 60}
        assert (await client.post("/v1/lease", json=lease, headers=other)).is_success
        assert (await client.post("/v1/calibration", headers=may)).status_code == 423
        await client.delete("/v1/lease", headers=other)
        assert (await client.post("/v1/calibration", headers=may)).status_code == 202
        assert (await client.delete("/v1/calibration", headers=may)).is_success


# One run.


def run_of(total: int = 40, patience: float = 10.0) -> tuple[Run, list[CalibrationRun]]:
    reports: list[CalibrationRun] = []
    return Run(Budget(), total, reports.append, patience=patience), reports


def scene_of(name: SceneName) -> CalibrationScene:
    return CalibrationScene(name, "Do it.", np.zeros((2, 2), np.float32))


async def test_confirmation_is_not_waited_for_for_ever() -> None:
    run, _ = run_of(patience=0.01)
    with pytest.raises(CalibrationError, match=r"within 0.01 s.*lamp.*start again"):
        run.wait_for(scene_of("lamp"))


async def test_every_twentieth_part_is_reported() -> None:
    run, reports = run_of(40)
    for _ in range(40):
        run.advance()
    assert [each.exposures for each in reports] == list(range(2, 41, 2))
    run.cancel()
    for ends in (run.advance, run.check):
        with pytest.raises(CancelledError):
            ends()
    with pytest.raises(ProblemError, match="no scene is waited for"):
        run.confirm("dark")


async def test_scene_is_confirmed_once() -> None:
    run, reports = run_of()
    waiting = threading.Thread(target=run.wait_for, args=(scene_of("dark"),))
    waiting.start()
    while not reports:
        await asyncio.sleep(0.001)
    run.confirm("dark")
    waiting.join()
    with pytest.raises(ProblemError):
        run.confirm("dark")
    assert [each.stage for each in reports] == ["waiting", "measuring"]


async def test_caller_told_to_wait_may_confirm_on_the_spot() -> None:
    """As a command does that asks at the terminal, on the thread that measures."""
    stages: list[str] = []

    def report(state: CalibrationRun) -> None:
        stages.append(state.stage)
        if state.stage == "waiting" and state.scene is not None:
            run.confirm(state.scene)

    run = Run(Budget(), 1, report, patience=0.01)
    run.wait_for(scene_of("dark"))
    assert (stages, run.state.stage) == (["waiting", "measuring"], "measuring")
