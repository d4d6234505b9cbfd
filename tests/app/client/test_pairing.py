"""Two cameras of one user, paired by their lines and found by their profiles."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from veilcam_client import AsyncCamera, Camera
from veilcam_client.cli.main import app
from veilcam_client.errors import AccessError
from veilcam_client.models import Capture
from veilcam_client.numbers import picture
from veilcam_client.profiles import profile_of
from veilcam_client.wire.tokens import ROLES
from veilcam_server.testing import FakeCamera

runner = CliRunner()


@pytest.fixture(scope="module")
def hall() -> Iterator[FakeCamera]:
    """A camera that wants tokens."""
    with FakeCamera({"auth": "tokens"}) as fake:
        yield fake


@pytest.fixture(scope="module")
def desk() -> Iterator[FakeCamera]:
    """A camera that wants none."""
    with FakeCamera() as fake:
        yield fake


def line_of(fake: FakeCamera, role: str) -> str:
    with fake.camera(token=fake.token(ROLES["owner"])) as owner:
        return owner.receivers.offer(role).line  # type: ignore[arg-type]


def run(*arguments: str) -> str:
    result = runner.invoke(app, list(arguments))
    assert result.exit_code == 0, result.output
    return result.stdout


def test_two_cameras_are_paired_and_asked_by_profile(
    hall: FakeCamera, desk: FakeCamera, tmp_path: Path, settings: Path
) -> None:
    run("pair", line_of(hall, "operator"), "--profile", "hall")
    run("pair", "--url", desk.url, "--profile", "desk")
    array = tmp_path / "e.npy"
    with Camera() as first, Camera(profile="desk") as second:
        found = [np.asarray(camera.capture().embedding) for camera in (first, second)]
        devices = [camera.status().device.key for camera in (first, second)]
        with pytest.raises(AccessError, match="the scope admin:tokens"):
            first.tokens.list()
    assert {values.shape for values in found} == {(24, 32)}
    assert devices == [profile_of(profile=name).device for name in ("hall", "desk")]
    assert len(set(devices)) == 2
    for options in ([], ["--profile", "desk"]):
        run("capture", "--out", str(array), *options)
        assert np.load(array).shape == (24, 32)
    assert {file.name for file in settings.iterdir()} == {
        *("config.toml", "hall.key", "hall.token", "desk.key"),
    }

    async def taken() -> Capture:
        async with AsyncCamera(profile="desk") as camera:
            return await camera.capture()

    assert np.asarray(asyncio.run(taken())).shape == (24, 32)


def test_line_pairs_once_and_a_viewer_takes_no_captures(hall: FakeCamera, settings: Path) -> None:
    line = line_of(hall, "viewer")
    assert "next:    veilcam classify" in run("pair", line)
    assert run("classify")
    refused = runner.invoke(app, ["capture"])
    assert refused.exit_code == 4
    again = runner.invoke(app, ["pair", line, "--profile", "again"])
    assert again.exit_code == 4
    assert "this line pairs nothing" in again.stderr
    assert "VEILCAM_TOKEN" not in again.stderr
    assert not list(settings.glob("again*"))


def test_paired_camera_is_measured(desk: FakeCamera, tmp_path: Path) -> None:
    run("pair", "--url", desk.url)
    shown = tmp_path / "pictures" / "7" / "a.png"
    shown.parent.mkdir(parents=True)
    shown.write_bytes(picture(np.eye(8, dtype=np.float32)))
    told = run("collect", str(tmp_path / "measured"), str(shown.parent.parent))
    assert told.startswith("1 measurements more")
