"""Camera for tests, as tests of another program use it."""

from __future__ import annotations

import asyncio
import logging
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import structlog

from veilcam_client.errors import AccessError, DeviceError, LeasedError, RequestTimeoutError
from veilcam_client.events import MaskChanged
from veilcam_client.models import Faults, SensorFaults
from veilcam_server.demo_data import load_digits
from veilcam_server.testing import FakeCamera

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def daemon() -> Iterator[FakeCamera]:
    with FakeCamera({"release": "raw", "raw_budget": 1000}) as fake:
        yield fake


@pytest.fixture
def fake(daemon: FakeCamera) -> FakeCamera:
    daemon.put_back()
    return daemon


@pytest.mark.thorough
def test_fake_camera_prints_nothing_and_logs_as_the_program_says(
    capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    with FakeCamera() as own, own.camera() as camera:
        camera.rotation.advance()
        assert not caplog.records
        caplog.set_level(logging.INFO, "veilcam_server")
        camera.simulation.set_faults(Faults(sensor=SensorFaults(gone=True)))
        with pytest.raises(DeviceError):
            camera.classify()
        assert structlog.is_configured()
    assert any(record.name.startswith("veilcam_server.") for record in caplog.records)
    assert capsys.readouterr() == ("", "")
    assert not structlog.is_configured()


@pytest.mark.numerical
def test_fake_camera_sees_the_scene_held_up(fake: FakeCamera) -> None:
    digits = load_digits()
    with fake.camera() as camera:
        found = []
        for index in range(5):
            camera.simulation.hold_scene(digits.images[index])
            found.append(camera.classify().label)
        assert found == [str(label) for label in digits.labels[:5]]
        capture = camera.capture()
        assert np.asarray(capture).shape == camera.status().bundle.embedding_shape
        assert camera.raw(camera.status).request_id


async def ask(fake: FakeCamera) -> tuple[str, list[str | None]]:
    async with fake.async_camera() as camera, fake.async_camera() as other:
        await camera.simulation.hold_scene(load_digits().images[0])
        label = (await camera.classify()).label
        async with camera.events() as events:
            heard = asyncio.create_task(anext(events))
            epochs: list[str | None] = []
            while not heard.done():
                epochs.append((await other.rotation.advance()).epoch)
            event = heard.result()
        assert isinstance(event, MaskChanged)
        return label, [event.epoch, *epochs]


def test_fake_camera_is_there_for_asyncio_too(fake: FakeCamera) -> None:
    label, (heard, *epochs) = asyncio.run(ask(fake))
    assert label == str(load_digits().labels[0])
    assert heard in epochs


def test_events_come_while_they_happen(fake: FakeCamera) -> None:
    with fake.camera() as camera, camera.events(last_event_id="") as events:
        first = next(events)
        epoch = camera.rotation.advance().epoch
        assert first.kind == "gap"
        assert any(getattr(event, "epoch", None) == epoch for event in events)


def test_stream_is_closed_from_another_thread(fake: FakeCamera) -> None:
    with fake.camera() as camera, fake.camera() as other:
        stream = camera.events(last_event_id="")
        next(stream)
        rotating = threading.Timer(0.05, other.rotation.advance)
        rotating.start()
        stream.close()
        assert list(stream) == []
        rotating.join()


def test_faults_are_those_of_a_camera_and_are_mended(fake: FakeCamera) -> None:
    with fake.camera(max_retries=0) as camera:
        camera.simulation.set_faults(Faults(sensor=SensorFaults(gone=True)))
        with pytest.raises(DeviceError):
            camera.capture()
    fake.put_back()
    with fake.camera() as camera:  # it asks again: a lost sensor is opened after a pause
        assert camera.capture().id


def test_two_callers_are_two(fake: FakeCamera) -> None:
    with fake.camera() as one, fake.camera() as other:
        one.lease.take(seconds=60)
        with pytest.raises(LeasedError):
            other.capture()
        fake.put_back()
        assert other.capture().id


def test_caller_waits_no_longer_than_it_wants(fake: FakeCamera) -> None:
    with fake.camera() as camera, pytest.raises(RequestTimeoutError):
        camera.capture(timeout=1e-6)


def test_tokens_are_wanted_where_they_are_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The environment of who runs the tests does not count.
    monkeypatch.setenv("VEILCAM_AUTH", "none")
    monkeypatch.setenv("VEILCAM_BUNDLE", "nowhere")
    fake = FakeCamera({"auth": "tokens", "state_dir": tmp_path / "state"})
    with pytest.raises(ValueError, match="within its context"):
        fake.camera()
    with fake:
        with fake.camera() as camera, pytest.raises(AccessError):
            camera.status()
        with fake.camera(token=fake.token(["read:status"])) as camera:
            assert camera.status().device.simulated
            with pytest.raises(AccessError):
                camera.rotation.advance()
    assert (tmp_path / "state").is_dir()


def test_fake_camera_leaves_no_thread_and_no_socket() -> None:
    threads = set(threading.enumerate())
    with FakeCamera() as fake, fake.camera() as camera:
        events = camera.events(last_event_id="")
        next(events)
        place = Path(fake.url.removeprefix("unix://"))
        assert place.is_socket()
    assert not place.exists()
    assert not {each.name for each in set(threading.enumerate()) - threads if not each.daemon}


def test_unknown_setting_is_refused() -> None:
    with pytest.raises(ValueError, match="exposures"):
        FakeCamera({"exposures": 1})


PROGRAM = """
import numpy as np
from veilcam_client.models import Faults, PanelFaults

def test_one(fake_camera):
    with fake_camera.camera() as camera:
        camera.simulation.hold_scene(np.zeros((28, 28), np.uint8))
        camera.lease.take(seconds=60)
        camera.simulation.set_faults(Faults(panel=PanelFaults(dead=True)))

def test_other(fake_camera):
    with fake_camera.camera() as camera:
        assert not camera.lease.get().held
        camera.rotation.advance()
        assert camera.classify().label
"""


def test_pytest_finds_the_fixture(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(PROGRAM)
    # Playwright's plugin, where it is installed, cannot run within itself.
    result = pytester.runpytest_inprocess("-p", "no:playwright")
    result.assert_outcomes(passed=2)


def test_plugin_is_installed_with_the_package() -> None:
    project = tomllib.loads((Path(__file__).parents[4] / "pyproject.toml").read_text())["project"]
    assert project["entry-points"]["pytest11"] == {"veilcam": "veilcam_server.pytest_plugin"}
