"""``veilcamd calibrate``, and the daemon that starts afterwards."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pytest
from rich.console import Console
from tests.unit.server.calibration.camera import Built
from tests.unit.server.calibration.test_record import make_record, settings_for
from typer.testing import CliRunner

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire.calibration import CalibrationStatus, SignedCalibration
from veilcam_optics.camera.geometry import Scene
from veilcam_optics.camera.imperfections import NOMINAL
from veilcam_optics.decoding import Precision, read_frame
from veilcam_server.calibration import service as calibration_service
from veilcam_server.calibration.procedure import Calibrated
from veilcam_server.calibration.record import calibration_store, imperfections_of, open_calibration
from veilcam_server.calibration.rig import CalibrationScene, Geometry, dark, lamp, white
from veilcam_server.calibration.service import CalibrationService
from veilcam_server.cli import calibration_session
from veilcam_server.cli.calibration_session import calibrate_device
from veilcam_server.cli.main import app
from veilcam_server.devices.base import Device
from veilcam_server.devices.simulated.scenes import FileScene
from veilcam_server.errors import CalibrationError, StartError
from veilcam_server.masks.fresh import FreshReader, FreshSource
from veilcam_server.sealing.identity import DeviceKey
from veilcam_server.settings import Settings
from veilcam_training.bundle import Bundle, read_bundle

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

SetScene: TypeAlias = Callable[[CalibrationScene], None]
COMMAND = ["calibrate", "--simulate", "--settle", "0.02", "--exposure", "0.001", "--repeats", "1"]


@pytest.mark.thorough
def test_command_keeps_what_was_found(
    fresh_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The measurement itself is tested elsewhere: here it is that of another camera."""
    built = Built()
    found = built.calibrate()
    held_up: list[float] = []

    def opened(settings: Settings, bundle: Bundle) -> Device:
        assert np.max(FileScene(Path(settings.scenes[0]), bundle.scene.shape).read()) == 0
        return built.device

    def measured(
        device: Device, geometry: Geometry, set_scene: SetScene, **told: Any
    ) -> Calibrated:
        assert device is built.device
        assert told["longest"] == pytest.approx(0.06)
        for scene in (white(geometry.scene), dark(geometry.scene)):
            set_scene(scene)
            assert device.scenes is not None
            held_up.append(float(device.scenes.read().mean()))
        told["advance"]()
        changes = {"exposure_s": told["exposure"], "geometry": geometry.digest}
        return replace(found, record=found.record.model_copy(update=changes))

    monkeypatch.setattr(calibration_session, "open_device", opened)
    monkeypatch.setattr(calibration_service, "calibrate", measured)
    state, frame = tmp_path / "state", tmp_path / "frame.safetensors"
    options = ["--bundle", str(fresh_file), "--state-dir", str(state), "--frame", str(frame)]
    result = CliRunner().invoke(app, [*COMMAND, *options])
    assert result.exit_code == 0, result.output
    assert held_up == [1.0, 0.0]
    for words in ("shift along y [um]", "drifted by", str(state / "calibration.json")):
        assert words in result.output
    assert (state / "calibration.png").read_bytes().startswith(b"\x89PNG")
    signed = calibration_store(state / "calibration.json").read()
    assert signed is not None
    assert signed.record.gain == found.record.gain
    assert read_frame(frame).imperfections == imperfections_of(signed.record)
    settings = settings_for(state, bundle=fresh_file, settle=0.02, exposure=0.001)
    key = DeviceKey.open(state)
    assert open_calibration(settings, read_bundle(fresh_file), key) == signed


def test_refusals_are_one_line_and_change_nothing(fresh_file: Path, tmp_path: Path) -> None:
    def refused(*options: str, code: int = 1) -> str:
        result = CliRunner().invoke(app, ["calibrate", "--simulate", *options])
        assert result.exit_code == code
        assert len(result.stderr.splitlines()) == 1
        return result.stderr

    before = set(tmp_path.iterdir())
    state = ("--state-dir", str(tmp_path))
    assert "--settle" in refused(*state, "--settle", "-1", code=2)
    assert set(tmp_path.iterdir()) == before
    assert "no such file" in refused(*state, "--bundle", "missing.veilcam")
    assert "--frame is for fresh masks" in refused(*state, "--frame", str(tmp_path / "frame"))
    assert set(tmp_path.iterdir()) == before


def test_person_is_told_what_to_set(
    fresh_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    console = Console(file=io.StringIO(), width=200)
    monkeypatch.setattr(console, "input", asked.append)
    device = replace(Built().device, scenes=None)

    def refused(device: Device, geometry: Geometry, set_scene: SetScene, **_: Any) -> Calibrated:
        for wanted in (dark, white, lamp):
            set_scene(wanted(geometry.scene))
        raise CalibrationError("too little light")

    monkeypatch.setattr(calibration_session, "open_device", lambda *_: device)
    monkeypatch.setattr(calibration_service, "calibrate", refused)
    settings = settings_for(tmp_path, bundle=fresh_file)
    with pytest.raises(CalibrationError, match="too little light"):
        calibrate_device(settings, console, out=None, picture=None, frame=None, repeats=2)
    assert isinstance(console.file, io.StringIO)
    told = console.file.getvalue()
    for words in (
        "Cover the camera",
        "12 cm wide and 12 cm high",
        "40 cm in front",
        "17.1 x 17.1 mm",
    ):
        assert words in told
    assert len(asked) == 3
    assert not (tmp_path / "calibration.json").exists()


def test_lamp_is_in_the_middle() -> None:
    for shape in ((28, 28), (7, 9), (3, 2)):
        image = lamp(Scene(*shape)).image
        assert np.array_equal(image, image[::-1, ::-1])
        assert 0 < image.mean() < 1


def test_decoders_are_prepared_for_what_was_found(fresh_bundle: Bundle) -> None:
    found = imperfections_of(make_record())
    key = EpochKey.generate(device="d7" * 32, bundle=fresh_bundle.digest)
    drawn, built = (
        FreshSource(fresh_bundle, imperfections=imperfections).make(key, frozenset())
        for imperfections in (NOMINAL, found)
    )
    assert np.array_equal(drawn.levels, built.levels)
    assert isinstance(drawn.reader, FreshReader)
    assert isinstance(built.reader, FreshReader)
    assert fresh_bundle.fresh is not None
    frame = fresh_bundle.fresh.frame(
        fresh_bundle.camera, fresh_bundle.scene, fresh_bundle.embedding
    )
    expected = replace(frame, imperfections=found)
    decoder = expected.decoding(precision=Precision.DOUBLE).prepare(expected.shown(built.levels))
    assert np.array_equal(built.reader.decoder.estimator, decoder.estimator)
    assert not np.allclose(drawn.reader.decoder.estimator, decoder.estimator, rtol=0.01)
    with pytest.raises(StartError, match="rows"):
        FreshSource(fresh_bundle, imperfections=replace(found, dead_rows=(9,)))


@pytest.mark.anyio
async def test_record_is_served(running: Running, bench: Bench) -> None:
    async with running() as client:
        answer = await client.get("/v1/calibration")
        assert answer.json() == {"signed": None, "run": None}
    signed = SignedCalibration(record=make_record(), public_key="a" * 64, signature="b" * 128)
    bench.calibration = CalibrationService(
        settings_for(bench.state_dir), bench.bundle, None, signed
    )
    async with running() as client:
        answer = await client.get("/v1/calibration")
        assert CalibrationStatus.model_validate_json(answer.content).signed == signed
