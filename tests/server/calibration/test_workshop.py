"""What a daemon measures with, and where it keeps what was found."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from veilcam_client.wire.calibration import CalibrationRun
from veilcam_server.calibration import Calibrated, CalibrationError, SigningKey, read_record
from veilcam_server.calibration import workshop as calibration_workshop
from veilcam_server.calibration.progress import Run
from veilcam_server.calibration.targets import dark, white
from veilcam_server.calibration.workshop import Workshop
from veilcam_server.devices.base import Device
from veilcam_training.bundle import Bundle

from .camera import Built
from .test_record import geometry_of, make_record, settings_for


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Of a measurement that presents two scenes and finds a record."""
    seen: dict[str, Any] = {}

    def measured(device: Device, geometry: Any, present: Any, **given: Any) -> Calibrated:
        seen.update(given)
        for scene in (dark(geometry.scene), white(geometry.scene)):
            present(scene)
            seen.setdefault("means", []).append(
                None if device.scenes is None else float(device.scenes.read().mean())
            )
        return Calibrated(make_record(), None)  # type: ignore[arg-type]

    monkeypatch.setattr(calibration_workshop, "calibrate", measured)
    return seen


def test_a_simulated_camera_holds_up_its_scenes(
    bundle: Bundle, tmp_path: Path, told: dict[str, Any]
) -> None:
    built, runs = Built(), list[CalibrationRun]()
    workshop = Workshop(settings_for(tmp_path, settle=0.2, exposure=0.03), bundle)
    workshop.measure(built.device, Run(10, runs.append), 3)
    assert told["means"] == [0.0, 1.0]
    assert (told["longest"], told["exposure"]) == (pytest.approx(0.6), 0.03)
    assert told["effort"].repeats == 3
    assert [run.scene for run in runs] == ["dark", "white card"]
    assert {run.stage for run in runs} == {"measuring"}
    # Taken away again.
    built.image = built.image * 0.25
    assert built.device.scenes is not None
    assert built.device.scenes.read().mean() == pytest.approx(0.25)


def test_a_person_is_waited_for_behind_an_opaque_panel(
    bundle: Bundle, tmp_path: Path, told: dict[str, Any]
) -> None:
    built, waits = Built(), threading.Semaphore(0)
    done: list[str] = []
    device = replace(built.device, scenes=None)
    device.display.blank = lambda: done.append("opaque")  # type: ignore[method-assign]

    def tell(run: CalibrationRun) -> None:
        if run.stage == "waiting":
            done.append(str(run.scene))
            waits.release()

    run = Run(10, tell)
    workshop = Workshop(settings_for(tmp_path), bundle)
    measuring = threading.Thread(target=workshop.measure, args=(device, run, 2))
    measuring.start()
    for scene in ("dark", "white card"):
        assert waits.acquire(timeout=10)
        run.presented(scene)
    measuring.join(10)
    assert done == ["opaque", "dark", "opaque", "white card"]


def test_a_record_is_kept_where_the_daemon_looks(bundle: Bundle, tmp_path: Path) -> None:
    path = tmp_path / "elsewhere" / "record.json"
    workshop = Workshop(settings_for(tmp_path, calibration=path), bundle)
    with pytest.raises(CalibrationError, match="elsewhere"):
        workshop.open_key()
    path.parent.mkdir()
    key = workshop.open_key()
    with pytest.raises(CalibrationError, match="another geometry"):
        workshop.sign(make_record(), key)
    signed = workshop.sign(make_record(geometry=geometry_of(bundle)), key)
    workshop.keep(signed)
    assert read_record(path, SigningKey.open(tmp_path)) == signed
    assert workshop.settle(signed) == pytest.approx(0.09)
    assert workshop.exposures(2) > workshop.exposures(1)
