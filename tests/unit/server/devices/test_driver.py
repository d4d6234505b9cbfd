"""A panel and a sensor of other kinds: a file each with a driver, and a line of the registry."""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pytest

from veilcam_server.devices import DeviceMissingError, DisplayError, SensorError
from veilcam_server.devices.registry import DISPLAYS, SENSORS, drivers, open_device
from veilcam_server.doctor.checkup import examine
from veilcam_server.doctor.machine import Machine
from veilcam_server.settings import Settings
from veilcam_server.wiring import DoctorSettings, Wiring

if TYPE_CHECKING:
    from veilcam_training.bundle import Bundle

PANEL = '''
import numpy as np

from veilcam_server.devices.base import Shown
from veilcam_server.devices.driver import DisplayDriver


class Prompt:
    """Obeys at once."""

    name, resets = "PROMPT", 1

    def __init__(self, camera, clock):
        self._window, self._clock = camera.window, clock
        self._levels = np.zeros((camera.panel.rows, camera.panel.columns), np.uint8)

    def show(self, levels):
        first_row, first_column = self._window.first_row, self._window.first_column
        rows, columns = levels.shape
        self._levels[first_row : first_row + rows, first_column : first_column + columns] = levels
        return Shown(self._clock())

    def blank(self):
        self._levels.fill(0)

    def close(self):
        pass

    def framebuffer(self):
        return self._levels.copy()

    def visible(self, at):
        return self._levels.astype(np.float32)

    def settled(self, at):
        return True


def _emulate(camera, *, scan, settle, read_back, clock):
    panel = Prompt(camera, clock)
    return lambda: panel, panel


DRIVER = DisplayDriver(
    name="PROMPT",
    open=lambda wiring, camera: Prompt(camera, lambda: 0.0),
    emulate=_emulate,
    packages=("prompt_bus",),
    needs={"gpio_chip": "the label on its board"},
)
'''

SENSOR = """
from veilcam_server.devices.driver import SensorDriver
from veilcam_server.devices.imx477 import DRIVER as IMX477


class Other:
    def __init__(self, sensor):
        self.capture, self.light, self.close = sensor.capture, sensor.light, sensor.close
        self.name, self.full_scale = "OTHER", sensor.full_scale


def _emulate(*given, **more):
    start, set_faults = IMX477.emulate(*given, **more)
    return lambda: Other(start()), set_faults


DRIVER = SensorDriver(
    name="OTHER",
    model="other",
    product="the other camera",
    open=lambda settings, shape, fill: Other(IMX477.open(settings, shape, fill)),
    emulate=_emulate,
    packages=("other_camera",),
)
"""


@pytest.fixture
def others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for file, text, registry in (("prompt", PANEL, DISPLAYS), ("other", SENSOR, SENSORS)):
        (tmp_path / f"veilcam_driver_{file}.py").write_text(text)
        monkeypatch.syspath_prepend(tmp_path)
        driver = importlib.import_module(f"veilcam_driver_{file}").DRIVER
        monkeypatch.setitem(registry, driver.name, driver)


@pytest.mark.usefixtures("others")
def test_panel_that_was_added_is_opened_with_what_it_needs(
    bundle: Bundle, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[tuple[object, ...]] = []
    bundle = replace(bundle, embedding=replace(bundle.embedding, fill=0.2))

    class Started:
        name, full_scale = "OTHER", 1.0

        def capture(self, not_before: float, timeout: float) -> None:
            raise SensorError("no light here")

        def close(self) -> None:
            """Nothing was opened."""

    def start(settings: Settings, shape: tuple[int, ...], fill: float) -> Any:
        opened.append((shape, fill))
        return Started()

    monkeypatch.setitem(SENSORS, "OTHER", replace(SENSORS["OTHER"], open=start))
    given: dict[str, Any] = {"bundle": Path("x.veilcam"), "panel": "PROMPT", "sensor": "OTHER"}
    with pytest.raises(DeviceMissingError, match="give --gpio-chip the label on its board"):
        open_device(Settings(**given), bundle)
    assert not opened
    device = open_device(Settings(**given, gpio_chip="mine"), bundle)
    assert (device.display.name, device.sensor.name) == ("PROMPT", "OTHER")
    device.display.blank()
    with pytest.raises(SensorError, match="no light here"):
        device.sensor.capture(0.0, 1.0)
    assert opened == [(bundle.embedding.shape, 0.2)]
    device.close()


@pytest.mark.usefixtures("others")
def test_doctor_looks_for_what_an_added_driver_needs(tmp_path: Path) -> None:
    machine = Machine(root=tmp_path, run=lambda *_: None)
    settings = DoctorSettings(panel="PROMPT", sensor="OTHER", state_dir=Path("/"))
    found = {finding.name: finding for finding in examine(machine, settings)}
    assert {"prompt_bus", "other_camera", "gpio chip"} <= set(found)
    assert found["gpio chip"].remedy == (
        "give --gpio-chip (or VEILCAM_GPIO_CHIP) the label on its board"
    )
    assert found["camera"].found == "needs other_camera"
    # It is on no bus of this machine, and no other panel's packages are asked for.
    assert not {"panel bus", "bus clock", "GPIO chip", "panel tab", "spidev"} & set(found)


@pytest.mark.usefixtures("others")
def test_driver_without_an_emulator_is_not_simulated(
    bundle: Bundle, scene_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(DISPLAYS, "PROMPT", replace(DISPLAYS["PROMPT"], emulate=None))
    settings = Settings.model_validate(
        {"device": "simulated", "panel": "PROMPT", "scenes": (str(scene_file),)}
    )
    with pytest.raises(DeviceMissingError, match="emulator for PROMPT and IMX477"):
        open_device(settings, bundle)


@pytest.mark.usefixtures("others")
@pytest.mark.parametrize("device", ["pi", "simulated"])
def test_panel_that_cannot_be_asked_is_not(
    bundle: Bundle, scene_file: Path, tmp_path: Path, device: Literal["pi", "simulated"]
) -> None:
    given: dict[str, Any] = {"panel": "PROMPT", "panel_read_back": "miso"}
    scenes = (str(scene_file),) if device == "simulated" else ()
    settings = Settings(bundle=Path("x.veilcam"), device=device, scenes=scenes, **given)
    with pytest.raises(DisplayError, match="PROMPT cannot be asked: leave out --panel-read-back"):
        open_device(settings, bundle)
    machine = Machine(root=tmp_path, run=lambda *_: None)
    found = {finding.name: finding for finding in examine(machine, DoctorSettings(**given))}
    assert found["panel answers"].outcome == "bad"
    assert found["panel answers"].remedy == "leave out --panel-read-back"


@pytest.mark.slow
@pytest.mark.usefixtures("others")
def test_added_panel_that_can_be_asked_is(
    bundle: Bundle, scene_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[bool] = []

    prompt: Any = DISPLAYS["PROMPT"].emulate

    def emulate(*given: Any, read_back: bool, **more: Any) -> Any:
        told.append(read_back)
        return prompt(*given, read_back=read_back, **more)

    asked = replace(DISPLAYS["PROMPT"], identify=lambda _: "a prompt", emulate=emulate)
    monkeypatch.setitem(DISPLAYS, "PROMPT", asked)
    given: dict[str, Any] = {"device": "simulated", "panel": "PROMPT", "sensor": "OTHER"}
    for read_back in (None, "miso", "sda"):
        more: dict[str, Any] = {"panel_read_back": read_back, "scenes": (str(scene_file),)}
        device = open_device(Settings(bundle=Path("x.veilcam"), **given, **more), bundle)
        assert (device.display.name, device.sensor.name) == ("PROMPT", "OTHER")
        device.display.show(np.zeros(bundle.camera.mask_shape, np.uint8))
        device.sensor.capture(0.0, 1.0)
    assert told == [False, True, True]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("panel", "--panel NONE has no driver: use ST7735R"),
        ("sensor", "--sensor NONE has no driver: use IMX477"),
    ],
)
def test_name_without_a_driver_is_refused(name: str, message: str) -> None:
    given: dict[str, Any] = {name: "NONE"}
    with pytest.raises(DeviceMissingError, match=message):
        drivers(Wiring(**given))
