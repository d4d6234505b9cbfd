"""Scenes held up before a simulated camera over REST."""

from __future__ import annotations

import asyncio
import io
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pydantic import ValidationError
from tests.app.server.conftest import asking

from veilcam_client import AsyncCamera
from veilcam_client.errors import ApiError, DeviceError, LeasedError
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.models import (
    EveryCaptures,
    Faults,
    LightFaults,
    PanelFaults,
    RotationOff,
    SensorFaults,
)
from veilcam_client.wire.captures import Capture, Classification
from veilcam_client.wire.status import Status
from veilcam_server.api.routes.simulation import MAX_PICTURE, PATH
from veilcam_server.daemon import build_service
from veilcam_server.sealing.receivers import ReceiverStore
from veilcam_server.settings import Settings
from veilcam_server.system.state_file import make_directory

pytestmark = pytest.mark.anyio
EXPOSURE = 0.2
KEY = ReceiverKey.generate()
"""Of a receiver, which is told of the scene, too."""


@pytest.fixture
def given(tmp_path: Path, bundle_file: Path, scene_file: Path) -> dict[str, Any]:
    state_dir = tmp_path / "state"
    make_directory(state_dir)
    ReceiverStore(state_dir).add("test", KEY.public)
    return {
        "device": "simulated",
        "rotation": RotationOff(),
        "bundle": bundle_file,
        "scenes": (str(scene_file),),
        "scene_api": True,
        "state_dir": state_dir,
        "settle": 0.0,
        "exposure": 0.0,
        "snr_db": float("inf"),
    }


@asynccontextmanager
async def camera(given: dict[str, Any]) -> AsyncIterator[AsyncCamera]:
    async with (
        asking(build_service(Settings.model_validate(given))) as http,
        AsyncCamera("http://localhost", http_client=http, max_retries=0, key=KEY) as sdk,
    ):
        yield sdk


async def reached(sdk: AsyncCamera, state: str) -> Status:
    while (status := await sdk.status()).state != state:
        await asyncio.sleep(0.02)
    return status


def seen_in(taken: Capture | Classification) -> int | None:
    """Which scene the camera says that it looked at, to its receivers alone."""
    return None if taken.notes is None else taken.notes.scene


def png(level: int) -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", (10, 20), (level, level, level)).save(stream, "PNG")
    return stream.getvalue()


@pytest.mark.slow
async def test_scene_held_up_is_what_captures_see(given: dict[str, Any]) -> None:
    async with camera(given) as sdk:
        first = await sdk.capture()
        assert seen_in(first) == 0
        assert (await sdk.simulation.hold_scene(np.full((28, 28), 9, np.uint8))).scene == 1
        dim = await sdk.capture()
        assert seen_in(dim) == 1
        assert np.asarray(dim).mean() < 0.1 * np.asarray(first).mean()
        assert (await sdk.simulation.hold_scene(png(255))).scene == 2
        label = await sdk.classify(include_embedding=True)
        assert seen_in(label) == 2
        # White, but half as wide as the scene.
        assert np.asarray(label.embedding).mean() > 0.5 * np.asarray(first).mean()
        assert (await sdk.simulation.hold_scene(None)).scene == 0
        again = await sdk.capture()
        assert seen_in(again) == 0
        assert np.asarray(again) == pytest.approx(np.asarray(first))


@pytest.mark.slow
async def test_capture_under_way_sees_to_its_end_what_it_began_with(given: dict[str, Any]) -> None:
    async with camera({**given, "exposure": EXPOSURE}) as sdk:
        before = np.asarray(await sdk.capture())
        under_way = asyncio.create_task(sdk.capture())
        await asyncio.sleep(EXPOSURE / 2)
        held = await sdk.simulation.hold_scene(np.full((28, 28), 9 / 255))
        old, new = await under_way, await sdk.capture()
    assert (seen_in(old), held.scene, seen_in(new)) == (0, 1, 1)
    assert np.asarray(old) == pytest.approx(before)
    assert np.asarray(new).mean() < 0.1 * before.mean()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("content", "media_type", "status", "code", "detail"),
    [
        (b"", "image/png", 422, "invalid_request", "this is no image, or damaged"),
        (b"\x89PNG\r\n\x1a\nabc", "image/png", 422, "invalid_request", "this is no image"),
        (png(0), "image/avif", 415, "unsupported_media_type", "image/png or image/jpeg or image/w"),
        (
            bytes(MAX_PICTURE + 1),
            *("application/x-npy", 413, "body_too_large", f"at most {MAX_PICTURE} bytes"),
        ),
    ],
)
async def test_scene_that_is_no_picture_changes_nothing(
    given: dict[str, Any], *, content: bytes, media_type: str, status: int, code: str, detail: str
) -> None:
    async with asking(build_service(Settings.model_validate(given))) as http:
        answer = await http.put(PATH, content=content, headers={"Content-Type": media_type})
        assert (answer.status_code, answer.json()["code"]) == (status, code)
        assert detail in answer.json()["detail"]
        async with AsyncCamera("http://localhost", http_client=http, key=KEY) as sdk:
            assert seen_in(await sdk.capture()) == 0
        assert (await http.get("/v1/diagnostics")).json()["faults"] == []


@pytest.mark.slow
async def test_lease_holder_decides_what_the_camera_sees(given: dict[str, Any]) -> None:
    async with camera(given) as sdk, sdk.lease.hold(seconds=30):
        other = AsyncCamera("http://localhost", http_client=sdk._transport.client, max_retries=0)
        async with other:
            with pytest.raises(LeasedError):
                await other.simulation.hold_scene(png(0))
        assert (await sdk.simulation.hold_scene(png(0))).scene == 1


def test_real_camera_takes_no_scenes() -> None:
    with pytest.raises(ValidationError, match="--scene-api is for a simulated camera"):
        Settings.model_validate({"device": "pi", "bundle": "a.veilcam", "scene_api": True})


@pytest.mark.thorough
@pytest.mark.parametrize("fault", ["dead", "open_window", "stuck", "inverted", "asleep"])
async def test_nothing_is_answered_behind_a_panel_that_does_not_hide(
    given: dict[str, Any], fault: str
) -> None:
    faults = PanelFaults.model_validate({fault: True})
    async with camera({**given, "rotation": EveryCaptures(captures=1)}) as sdk:
        good = await sdk.capture()
        await sdk.simulation.set_faults(Faults(panel=faults))
        with pytest.raises(ApiError) as caught:
            await sdk.capture()
        assert caught.value.code == "panel_not_hiding"
        assert good.epoch in str(caught.value)
        # A reset wakes a panel up that fell asleep, and mends no other.
        if not faults.asleep:
            await sdk.simulation.set_faults(Faults())
        await reached(sdk, "ready")
        assert (await sdk.capture()).epoch != good.epoch


@pytest.mark.slow
async def test_lamp_that_goes_out_accuses_no_panel(given: dict[str, Any]) -> None:
    async with camera({**given, "rotation": EveryCaptures(captures=1)}) as sdk:
        await sdk.capture()
        await sdk.simulation.set_faults(Faults(light=LightFaults(lamp=0)))
        with pytest.raises(ApiError) as caught:
            await sdk.capture()
        assert caught.value.code == "light_unsteady"
        # In the dark the last verdict holds.
        await sdk.capture()
        assert (await sdk.status()).state == "ready"


@pytest.mark.thorough
@pytest.mark.parametrize("fault", ["gone", "silent", "stuck"])
async def test_sensor_that_fails_is_an_error_and_then_a_state(
    given: dict[str, Any], fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("veilcam_server.settings.CAPTURE_TIMEOUT", 0.05)
    faults = SensorFaults.model_validate({fault: True})
    async with camera(given) as sdk:
        await sdk.capture()
        await sdk.simulation.set_faults(Faults(sensor=faults))
        with pytest.raises(DeviceError) as caught:
            await sdk.capture()
        assert caught.value.code == "sensor_failed"
        assert (await sdk.status()).state == "ready"
        with suppress(DeviceError):  # the first frame after it was opened is none from before
            await sdk.capture()
        if faults.stuck:
            return
        status = await sdk.status()
        assert status.state == "degraded"
        assert status.remedy == ("run_doctor" if faults.gone else "check_camera_cable")
        with pytest.raises(DeviceError) as caught:
            await sdk.capture()
        assert caught.value.code == "not_ready"
        await sdk.simulation.set_faults(Faults())
        await reached(sdk, "ready")
        await sdk.capture()


@pytest.mark.slow
async def test_scene_api_has_to_be_allowed(given: dict[str, Any]) -> None:
    async with camera({**given, "scene_api": False}) as sdk:
        for asked in (
            sdk.simulation.hold_scene(png(0)),
            sdk.simulation.hold_scene(None),
            sdk.simulation.set_faults(Faults(panel=PanelFaults(dead=True))),
        ):
            with pytest.raises(ApiError, match="start it with --simulate --scene-api") as caught:
                await asked
            assert caught.value.code == "not_enabled"
        assert np.asarray(await sdk.capture()).any()
