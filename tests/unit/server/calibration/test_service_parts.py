"""Scenes and record of a calibration service without a daemon."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from veilcam_client.wire.calibration import CalibrationRun
from veilcam_server.calibration import service as calibration_service
from veilcam_server.calibration.procedure import Calibrated
from veilcam_server.calibration.record import calibration_store
from veilcam_server.calibration.rig import dark, white
from veilcam_server.calibration.service import CalibrationService
from veilcam_server.devices.base import Device
from veilcam_server.errors import CalibrationError
from veilcam_server.sealing.identity import DeviceKey
from veilcam_training.bundle import Bundle

from .camera import Built
from .test_record import geometry_of, make_record, settings_for


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Of a measurement that sets two scenes and finds a record."""
    seen: dict[str, Any] = {}

    def measured(device: Device, geometry: Any, set_scene: Any, **given: Any) -> Calibrated:
        seen.update(given)
        for scene in (dark(geometry.scene), white(geometry.scene)):
            set_scene(scene)
            seen.setdefault("means", []).append(
                None if device.scenes is None else float(device.scenes.read().mean())
            )
        return Calibrated(make_record(), None)  # type: ignore[arg-type]

    monkeypatch.setattr(calibration_service, "calibrate", measured)
    return seen


def test_simulated_camera_has_its_scenes_set(
    bundle: Bundle, tmp_path: Path, told: dict[str, Any]
) -> None:
    built, reports = Built(), list[CalibrationRun]()
    service = CalibrationService(
        settings_for(tmp_path, settle=0.2, exposure=0.03), bundle, DeviceKey.open(tmp_path)
    )
    service.measure(built.device, service.begin(3, reports.append))
    assert told["means"] == [0.0, 1.0]
    assert (told["longest"], told["exposure"]) == (pytest.approx(0.6), 0.03)
    assert told["budget"].repeats == 3
    assert [run.scene for run in reports] == [None, "dark", "white card"]
    assert {run.stage for run in reports} == {"measuring"}
    # Taken away again.
    built.image = built.image * 0.25
    assert built.device.scenes is not None
    assert built.device.scenes.read().mean() == pytest.approx(0.25)


def test_person_is_waited_for_behind_an_opaque_panel(
    bundle: Bundle, tmp_path: Path, told: dict[str, Any]
) -> None:
    built, waits = Built(), threading.Semaphore(0)
    done: list[str] = []
    device = replace(built.device, scenes=None)
    device.display.blank = lambda: done.append("opaque")  # type: ignore[method-assign]

    def report(run: CalibrationRun) -> None:
        if run.stage == "waiting":
            done.append(str(run.scene))
            waits.release()

    service = CalibrationService(settings_for(tmp_path), bundle, DeviceKey.open(tmp_path))
    run = service.begin(2, report)
    measuring = threading.Thread(target=service.measure, args=(device, run))
    measuring.start()
    for scene in ("dark", "white card"):
        assert waits.acquire(timeout=100)
        run.confirm(scene)
    measuring.join(100)
    assert done == ["opaque", "dark", "opaque", "white card"]


def test_record_is_kept_where_the_daemon_looks(bundle: Bundle, tmp_path: Path) -> None:
    path = tmp_path / "elsewhere" / "record.json"
    service = CalibrationService(
        settings_for(tmp_path, calibration=path), bundle, DeviceKey.open(tmp_path)
    )
    with pytest.raises(CalibrationError, match="elsewhere"):
        service.begin(1, lambda _: None)
    path.parent.mkdir()
    totals = [service.begin(repeats, lambda _: None).state.total for repeats in (1, 2)]
    assert totals[0] < totals[1]
    with pytest.raises(CalibrationError, match="another geometry"):
        service.sign(make_record())
    signed = service.sign(make_record(geometry=geometry_of(bundle)))
    service.write(signed)
    assert calibration_store(path).read() == signed
