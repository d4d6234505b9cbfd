"""The record: signed, checked, and used."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.unit.server.damage import DAMAGES

from veilcam_client.wire.calibration import CalibrationRecord, Quantity, SignedCalibration
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_server.calibration.record import (
    RECORD_NAME,
    calibration_store,
    imperfections_of,
    open_calibration,
    settle_time,
    sign_record,
)
from veilcam_server.calibration.rig import Geometry
from veilcam_server.devices.base import Device, Exposure, Light
from veilcam_server.devices.corrected import CalibratedSensor, calibrated
from veilcam_server.errors import ProblemError, StartError, StorageError
from veilcam_server.sealing.identity import KEY_NAME, DeviceKey
from veilcam_server.settings import Settings
from veilcam_training.bundle import Bundle


def make_record(**changes: Any) -> CalibrationRecord:
    def quantity(value: float) -> Quantity:
        return Quantity(value=value, uncertainty=0.01, residual=0.02)

    given: dict[str, Any] = {
        "taken_at": datetime(2026, 1, 2, 3, 4, 5, 678, tzinfo=UTC),
        "display": "ST7735R",
        "sensor": "IMX477",
        "simulated": True,
        "exposure_s": 0.01,
        "geometry": "0" * 64,
        "settling_s": quantity(0.08),
        "black_level": quantity(0.02),
        "gain": quantity(0.5),
        "full_scale": quantity(2.0),
        "gamma": quantity(1.3),
        "contrast_floor": quantity(0.05),
        "dead_rows": (3,),
        "dead_transmittance": quantity(1 / 3),
        "shift_y_m": quantity(1.1e-5),
        "shift_x_m": quantity(-2e-5),
        "rotation_rad": quantity(1e-3),
        "distance_error_m": quantity(5e-5),
        "stray_light": quantity(0.0),
        "psf_residual": 0.016,
        "drift": -0.001,
    }
    return CalibrationRecord(**given | changes)


def unsigned() -> SignedCalibration:
    return SignedCalibration(record=make_record(), public_key="0" * 64, signature="0" * 128)


def written(path: Path, record: CalibrationRecord, key: DeviceKey) -> SignedCalibration:
    signed = sign_record(record, key)
    calibration_store(path).change(lambda _: signed)
    return signed


@pytest.fixture
def key(tmp_path: Path) -> DeviceKey:
    return DeviceKey.open(tmp_path)


def test_record_written_is_read(tmp_path: Path, key: DeviceKey) -> None:
    path = tmp_path / RECORD_NAME
    record = make_record()
    signed = written(path, record, key)
    assert calibration_store(path).read() == signed
    assert signed.record == record
    assert {each.name for each in tmp_path.iterdir()} == {
        f"{name}{end}" for name in (RECORD_NAME, KEY_NAME) for end in ("", ".copy", ".lock")
    }
    assert all(each.stat().st_mode & 0o777 == 0o600 for each in tmp_path.iterdir())
    found = imperfections_of(record)
    assert (found.shift_y, found.shift_x, found.rotation) == (1.1e-5, -2e-5, 1e-3)
    assert (found.distance_error, found.gamma, found.contrast_floor) == (5e-5, 1.3, 0.05)
    assert (found.dead_rows, found.dead_columns, found.dead_transmittance) == ((3,), (), 1 / 3)


@pytest.mark.parametrize(
    "changes",
    [
        {"gain": Quantity(value=0.6, uncertainty=0.01, residual=0.02)},
        {"dead_rows": ()},
        {"simulated": False},
        {"taken_at": datetime(2027, 1, 2, 3, 4, 5, tzinfo=UTC)},
    ],
    ids=str,
)
def test_record_changed_after_it_was_signed_is_not_used(
    tmp_path: Path, key: DeviceKey, bundle: Bundle, changes: dict[str, Any]
) -> None:
    faults: list[ProblemError] = []
    signed = sign_record(make_record(geometry=geometry_of(bundle)), key)
    changed = signed.model_copy(update={"record": signed.record.model_copy(update=changes)})
    calibration_store(tmp_path / RECORD_NAME).change(lambda _: changed)
    assert open_calibration(settings_for(tmp_path), bundle, key, faults.append) is None
    assert [fault.code for fault in faults] == ["calibration_impossible"]


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"record": 1}', "x" * 2_000_000, "\x00\xff"])
def test_file_that_is_no_record_is_none(tmp_path: Path, key: DeviceKey, text: str) -> None:
    path = tmp_path / RECORD_NAME
    path.write_text(text)
    faults: list[ProblemError] = []
    assert calibration_store(path, faults.append).read() is None
    assert "calibration.json is damaged" in str(faults[0])
    assert "the camera is taken as it was drawn; run 'veilcamd calibrate' again" in str(faults[0])


def test_record_alone_is_read_where_it_lies(tmp_path: Path, key: DeviceKey) -> None:
    """As one that was made elsewhere is, for ``--calibration``."""
    signed = written(tmp_path / RECORD_NAME, make_record(), key)
    alone = tmp_path / "alone"
    alone.mkdir()
    (tmp_path / RECORD_NAME).rename(alone / "given.json")
    assert calibration_store(alone / "given.json").read() == signed
    assert [path.name for path in alone.iterdir()] == ["given.json"]


def test_unwritable_place_is_said(tmp_path: Path, key: DeviceKey) -> None:
    with pytest.raises(StorageError, match="cannot be written"):
        written(tmp_path / "missing" / RECORD_NAME, make_record(), key)


def settings_for(tmp_path: Path, **given: Any) -> Settings:
    return Settings(**{"device": "simulated", "state_dir": tmp_path, **given})


def geometry_of(bundle: Bundle) -> str:
    return Geometry(bundle.camera, bundle.scene, bundle.embedding).digest


def test_daemon_takes_the_record_in_its_state_directory(
    tmp_path: Path, key: DeviceKey, bundle: Bundle
) -> None:
    assert open_calibration(settings_for(tmp_path), bundle, key) is None
    signed = written(tmp_path / RECORD_NAME, make_record(geometry=geometry_of(bundle)), key)
    assert open_calibration(settings_for(tmp_path), bundle, key) == signed
    elsewhere = tmp_path / "elsewhere.json"
    with pytest.raises(StartError, match=r"elsewhere\.json holds no calibration that is whole"):
        open_calibration(settings_for(tmp_path, calibration=elsewhere), bundle, key)
    other = written(elsewhere, make_record(geometry=geometry_of(bundle), drift=0.01), key)
    assert open_calibration(settings_for(tmp_path, calibration=elsewhere), bundle, key) == other


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_damaged_record_is_put_right_and_a_lost_one_refuses_no_start(
    tmp_path: Path, key: DeviceKey, bundle: Bundle, damage: Callable[[Path], None]
) -> None:
    faults: list[ProblemError] = []
    signed = written(tmp_path / RECORD_NAME, make_record(geometry=geometry_of(bundle)), key)
    damage(tmp_path / RECORD_NAME)
    assert open_calibration(settings_for(tmp_path), bundle, key, faults.append) == signed
    assert [fault.code for fault in faults] == ["state_damaged"]
    faults.clear()
    for name in (RECORD_NAME, f"{RECORD_NAME}.copy"):
        damage(tmp_path / name)
    assert open_calibration(settings_for(tmp_path), bundle, key, faults.append) is None
    assert [fault.code for fault in faults] == ["state_lost"]


def test_record_that_another_key_signed_is_told_and_not_used(
    tmp_path: Path, key: DeviceKey, bundle: Bundle
) -> None:
    faults: list[ProblemError] = []
    written(tmp_path / RECORD_NAME, make_record(geometry=geometry_of(bundle)), key)
    other = DeviceKey.open(tmp_path / "other")
    assert open_calibration(settings_for(tmp_path), bundle, other, faults.append) is None
    assert [fault.code for fault in faults] == ["calibration_impossible"]
    assert "calibration.json was signed by another device: run 'veilcamd" in str(faults[0])
    # One that was named must be the one that is used.
    named = settings_for(tmp_path, calibration=tmp_path / RECORD_NAME)
    with pytest.raises(StartError, match="was signed by another device"):
        open_calibration(named, bundle, other)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"geometry": "f" * 64}, "geometry"),
        ({"display": "another"}, "panel"),
        ({"sensor": "another"}, "sensor"),
        ({"simulated": False}, "kind of device, real, not simulated"),
        ({"exposure_s": 0.02}, "exposure"),
        ({"tab": "red"}, "panel's tab"),
    ],
)
def test_record_of_another_camera_is_refused(
    tmp_path: Path, key: DeviceKey, bundle: Bundle, changes: dict[str, Any], what: str
) -> None:
    record = make_record(**{"geometry": geometry_of(bundle)} | changes)
    written(tmp_path / RECORD_NAME, record, key)
    with pytest.raises(StartError, match=f"another {what}.*run 'veilcamd calibrate'"):
        open_calibration(settings_for(tmp_path), bundle, key)


def test_geometries_differ() -> None:
    drawings = {
        Geometry(Camera(), Scene(), Embedding()).digest,
        Geometry(Camera(distance=4.1e-3), Scene(), Embedding()).digest,
        Geometry(Camera(), Scene(height=0.13), Embedding()).digest,
        Geometry(Camera(), Scene(), Embedding(12, 16)).digest,
    }
    assert len(drawings) == 4


def test_fence_never_grants_less_than_was_measured(tmp_path: Path) -> None:
    signed, measured = unsigned(), 0.08 + 0.01
    assert settle_time(settings_for(tmp_path), None) == Settings.model_fields["settle"].default
    assert settle_time(settings_for(tmp_path), signed) == pytest.approx(measured)
    assert settle_time(settings_for(tmp_path, settle=0.02), signed) == pytest.approx(measured)
    assert settle_time(settings_for(tmp_path, settle=0.2), signed) == 0.2


class Sensor:
    name, full_scale, closed = "a sensor", 1.0, False

    def __init__(self, light: tuple[float, float] = (0.02, 0.52)) -> None:
        self._light = np.array([light])

    def capture(self, not_before: float, timeout: float) -> Exposure:
        mean = Light(float(self._light.mean()), 1e-4)
        return Exposure(self._light.astype(np.float32), not_before, timeout, light=mean)

    def light(self, not_before: float, timeout: float) -> Light:
        return self.capture(not_before, timeout).light

    def close(self) -> None:
        self.closed = True


def test_measurements_are_those_that_decoders_expect() -> None:
    sensor = Sensor()
    corrected = CalibratedSensor(sensor, black_level=0.02, gain=0.5, stray_light=0.0)
    exposure = corrected.capture(1.0, 2.0)
    np.testing.assert_allclose(exposure.embedding, [[0.0, 1.0]], atol=1e-7)
    assert exposure.embedding.dtype == np.float32
    # A guard that compares light with light wants it as it came.
    assert exposure.light.mean == corrected.light(1.0, 2.0).mean == pytest.approx(0.27)
    assert (exposure.started_at, exposure.ended_at) == (1.0, 2.0)
    assert corrected.full_scale == pytest.approx(0.98 / 0.5)
    assert corrected.name == "a sensor"
    corrected.close()
    assert sensor.closed


def test_light_that_went_astray_is_put_back() -> None:
    # A tenth of the light (0, 1) is spread evenly: (0.05, 0.95).
    hazy = Sensor((0.02 + 0.5 * 0.05, 0.02 + 0.5 * 0.95))
    corrected = CalibratedSensor(hazy, black_level=0.02, gain=0.5, stray_light=0.1)
    np.testing.assert_allclose(corrected.capture(1.0, 2.0).embedding, [[0.0, 1.0]], atol=1e-7)


def test_device_without_a_record_is_left_alone() -> None:
    device = Device(None, Sensor(), simulated=True)  # type: ignore[arg-type]
    assert calibrated(device, None) is device
    assert calibrated(device, unsigned()).sensor.full_scale == pytest.approx(0.98 / 0.5)
