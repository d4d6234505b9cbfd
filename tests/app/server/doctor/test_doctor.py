"""The doctor on machines that have everything but one thing."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, Never

import pytest
from typer.testing import CliRunner

from veilcam_client.wire.status import WallClock
from veilcam_server.cli.main import app
from veilcam_server.devices import DeviceMissingError, DisplayError
from veilcam_server.devices.driver import DisplayDriver
from veilcam_server.devices.extras import import_extra
from veilcam_server.devices.registry import DISPLAYS
from veilcam_server.doctor import machine as machines
from veilcam_server.doctor.checkup import examine, examine_beside
from veilcam_server.doctor.finding import Finding
from veilcam_server.doctor.machine import Machine
from veilcam_server.settings import Settings
from veilcam_server.wiring import DoctorSettings, Wiring
from veilcam_training.bundle import read_key, sign_bundle, write_key

runner = CliRunner()
PROGRAMS: dict[tuple[str, ...], str] = {
    ("systemctl", "--version"): "systemd 257 (257.7-1)\n+PAM +AUDIT"
}


@dataclass
class Bed:
    """A machine in a folder, which a test makes ill."""

    root: Path
    locked: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    programs: dict[tuple[str, ...], str] = field(default_factory=PROGRAMS.copy)
    room: int = 10 * 2**30
    synchronised: bool = True
    chips: Mapping[str, Path] = field(
        default_factory=lambda: {"pinctrl-rp1": Path("/dev/gpiochip0")}
    )
    users: dict[int, str] = field(default_factory=dict)
    camera: str | Exception = "imx477"
    opened: list[int] = field(default_factory=list)
    closed: list[bool] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.write("/proc/device-tree/model", "Raspberry Pi 5 Model B Rev 1.0\0")
        self.write("/boot/firmware/config.txt", "# a comment\ndtparam=spi=on\n")
        for name in ("/dev/spidev0.0", "/dev/dma_heap/linux,cma", "/dev/dma_heap/system"):
            self.write(name, "")
        (self.root / "var/lib/veilcam").mkdir(parents=True, mode=0o700)

    def write(self, path: str, text: str) -> None:
        file = self.root / path.lstrip("/")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)

    def remove(self, path: str) -> None:
        (self.root / path.lstrip("/")).unlink()

    def load(self, name: str) -> object:
        """As the real machine does, but what there is to import is an empty package."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(sys.modules, name, None if name in self.missing else ModuleType(name))
            return import_extra(name)

    def open_camera(self, number: int) -> Any:
        if isinstance(self.camera, Exception):
            raise self.camera
        self.opened.append(number)
        return SimpleNamespace(
            camera_properties={"Model": self.camera}, close=lambda: self.closed.append(True)
        )

    @property
    def machine(self) -> Machine:
        return Machine(
            root=self.root,
            load=self.load,
            may_write=lambda path: "/" + str(path.relative_to(self.root)) not in self.locked,
            run=lambda *command: self.programs.get(command),
            clock=lambda: WallClock(zone="Asia/Tokyo", synchronised=self.synchronised),
            free=lambda _: self.room,
            chips=lambda: self.chips,
            line_user=lambda _, line: self.users.get(line),
            open_camera=self.open_camera,
        )


@pytest.fixture
def bed(tmp_path: Path) -> Bed:
    return Bed(tmp_path / "root")


@pytest.fixture
def plan(bundle_file: Path) -> DoctorSettings:
    return DoctorSettings(panel_tab="green", state_dir=Path("/var/lib/veilcam"), bundle=bundle_file)


def findings(bed: Bed, plan: DoctorSettings) -> dict[str, Finding]:
    found = list(examine(bed.machine, plan))
    assert len({finding.name for finding in found}) == len(found)
    # Whatever is wrong, there is something to do about it, and it fits a line.
    for finding in found:
        assert (finding.remedy is not None) == (finding.outcome == "bad")
        assert "\n" not in finding.found + str(finding.remedy)
    return {finding.name: finding for finding in found}


def test_machine_that_has_everything(bed: Bed, plan: DoctorSettings) -> None:
    found = findings(bed, plan)
    assert {finding.outcome for finding in found.values()} == {"ok"}
    assert len(found) == 20
    assert found["board"].found == "Raspberry Pi 5 Model B Rev 1.0"
    assert found["wall clock"].found == "Asia/Tokyo, synchronised"
    assert bed.opened == [0]
    assert bed.closed == [True]


Illness = Callable[[Bed], object]


def without(path: str) -> Illness:
    return lambda bed: bed.remove(path)


def lacking(package: str) -> Illness:
    return lambda bed: bed.missing.append(package)


def locked(*paths: str) -> Illness:
    return lambda bed: bed.locked.extend(paths)


def having(**values: object) -> Illness:
    return lambda bed: vars(bed).update(values)


STATE = "var/lib/veilcam"
NO_CAMERA = DeviceMissingError("there is no camera 0: check its cable")
HEAPS = ("/dev/dma_heap/linux,cma", "/dev/dma_heap/system")
OLD = {("systemctl", "--version"): "systemd 247 (247.3)"}
ILLNESSES: list[tuple[Illness, str, str, str]] = [
    (without("/proc/device-tree/model"), "board", "no Raspberry Pi", "--simulate"),
    (lacking("spidev"), "spidev", "not installed", "apt install python3-spidev"),
    (lacking("gpiod"), "gpiod", "not installed", "reinstall ./veilcam_*.deb"),
    (lacking("libcamera"), "libcamera", "not installed", "apt install"),
    (lacking("picamera2"), "picamera2", "not installed", "install python3-picamera2"),
    (without("/dev/spidev0.0"), "panel bus", "there is no", "config.txt: restart"),
    (locked("/dev/spidev0.0"), "panel bus", "not yours", "-aG spi"),
    (having(chips={}), "GPIO chip", "none that you may open", "-aG gpio"),
    (having(chips={"gpio-sim": Path("/x")}), "GPIO chip", "there is gpio-sim", "--gpio-chip"),
    (having(users={25: "veilcamd"}), "line of D/C", "used by veilcamd", "end what"),
    (having(users={24: "fan"}), "line of RESET", "24, used by fan", "another line"),
    (locked(*HEAPS), "frame memory", "not yours", "-aG video"),
    (having(camera=NO_CAMERA), "camera", "there is no camera 0", "check its cable"),
    (having(camera="ov5647"), "camera", "ov5647", "HQ camera"),
    (locked("/var/lib/veilcam"), "state directory", "written", "chown"),
    (
        lambda bed: (bed.root / STATE).chmod(0o755),
        "state directory",
        "others may look (0755)",
        "chmod 700",
    ),
    (
        lambda bed: os.mkfifo(bed.root / STATE / "tokens.json"),
        "state directory",
        "tokens.json cannot be read (Not a regular file)",
        "move it away",
    ),
    (having(room=2**20), "disk", "1 MiB free", "make room"),
    (
        having(synchronised=False),
        "wall clock",
        "Asia/Tokyo, not synchronised",
        "set-ntp true, or --trust-clock",
    ),
    (having(programs={}), "systemd", "not there", "systemd"),
    (having(programs=OLD), "systemd", "247", "248 or later"),
]


@pytest.mark.parametrize(("illness", "name", "found", "remedy"), ILLNESSES)
def test_missing_part_is_named_and_how_to_get_it(
    bed: Bed, plan: DoctorSettings, *, illness: Illness, name: str, found: str, remedy: str
) -> None:
    illness(bed)
    finding = findings(bed, plan)[name]
    assert finding.outcome == "bad"
    assert found in finding.found
    assert remedy in str(finding.remedy)


def test_doctor_says_which_release_runs_and_whether_it_is_the_one_installed(
    bed: Bed, plan: DoctorSettings
) -> None:
    assert "release" not in findings(bed, plan)  # of a checkout
    bed.write("/usr/lib/veilcam/unpacked/RELEASE", "2.0-bb\n")
    state = bed.root / "var/lib/veilcam-release"
    state.mkdir()
    for name, outcome in (("2.0-bb", "ok"), ("1.0-aa", "bad")):
        (state / "current").unlink(missing_ok=True)
        (state / "current").symlink_to(f"/usr/lib/veilcam/releases/{name}")
        finding = findings(bed, plan)["release"]
        assert finding.outcome == outcome
        assert name in finding.found
    assert "2.0-bb did not start" in finding.found
    assert "journalctl" in str(finding.remedy)


BROKEN = {
    "ValueError": "numpy.dtype size changed, may indicate binary incompatibility.\\nExpected 96",
    "ImportError": "libcap.so.2: cannot open shared object file",
    "RuntimeError": "",
}


@pytest.mark.parametrize("name", ["spidev", "gpiod", "libcamera", "picamera2"])
@pytest.mark.parametrize(("kind", "text"), BROKEN.items())
def test_package_that_fails_at_import_is_named_with_its_error(
    bed: Bed,
    plan: DoctorSettings,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    *,
    name: str,
    kind: str,
    text: str,
) -> None:
    (tmp_path / f"{name}.py").write_text(f'raise {kind}("{text}")\n')
    monkeypatch.syspath_prepend(tmp_path)

    def load(wanted: str) -> object:
        return import_extra(name) if wanted == name else bed.load(wanted)

    found = {each.name: each for each in examine(replace(bed.machine, load=load), plan)}
    assert len(found) == 20
    assert found[name].outcome == "bad"
    assert kind in found[name].found
    assert text.partition("\\n")[0] in found[name].found
    assert "\n" not in found[name].found
    package = "./veilcam_*.deb" if name == "gpiod" else f"python3-{name}"
    assert f"sudo apt install --reinstall {package}" in str(found[name].remedy)
    # What needs it waits, and all the rest is looked at.
    waiting = {each.name for each in found.values() if each.outcome == "skipped"}
    lines = {"GPIO chip", "line of D/C", "line of RESET"}
    assert waiting == {"spidev": set(), "gpiod": lines}.get(name, {"camera"})
    assert found["systemd"].outcome == "ok"


def test_check_that_fails_keeps_back_no_other(bed: Bed, plan: DoctorSettings) -> None:
    def fail(*_: object) -> Any:
        raise KeyError("no such\nthing")

    machine = bed.machine
    well = {each.name for each in examine(machine, plan)}
    broken = replace(machine, chips=fail, open_camera=fail, free=fail, may_write=fail, run=fail)
    found = {each.name: each for each in examine(broken, plan)}
    assert well - set(found) == {"line of D/C", "line of RESET"}
    for name in ("GPIO chip", "camera", "disk", "panel bus", "state directory", "systemd"):
        assert found[name].outcome == "bad"
        assert "KeyError" in found[name].found
        assert "\n" not in found[name].found
    assert found["bundle"].outcome == "ok"


def test_spi_that_is_off_is_switched_on(bed: Bed, plan: DoctorSettings) -> None:
    bed.remove("/dev/spidev0.0")
    bed.write("/boot/firmware/config.txt", "#dtparam=spi=on\n")
    assert "raspi-config nonint do_spi 0" in str(findings(bed, plan)["panel bus"].remedy)


def test_wiring_is_looked_at_as_it_is_set(bed: Bed, plan: DoctorSettings) -> None:
    wired: dict[str, Any] = {"spi": Path("/dev/spidev1.0"), "spi_hz": 16_000_000, "data_line": 5}
    wiring = plan.model_copy(update={**wired, "panel_tab": None, "camera_number": 1})
    bed.users[5] = "somebody"
    found = findings(bed, wiring)
    for name, text in (
        ("panel bus", "/dev/spidev1.0"),
        ("bus clock", "too fast"),
        ("panel tab", "not known"),
        ("line of D/C", "5, used by somebody"),
    ):
        assert found[name].outcome == "bad"
        assert text in found[name].found
    assert bed.opened == [1]


def answering(answer: str | Exception) -> DisplayDriver:
    """A driver whose panel says that."""

    def identify(wiring: Wiring) -> str:
        assert wiring.panel_read_back == "miso"
        if isinstance(answer, Exception):
            raise answer
        return answer

    return replace(DISPLAYS["ST7735R"], identify=identify)


def test_panel_that_is_wired_to_answer_is_asked(
    bed: Bed, plan: DoctorSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    wired = plan.model_copy(update={"panel_read_back": "miso"})
    name = "panel answers"
    for answer, outcome, found, remedy in (
        ("identity 7c89f0", "ok", "identity 7c89f0", None),
        (DisplayError("it is silent: look"), "bad", "it is silent", "look"),
        (OSError(22, "Invalid argument"), "bad", "OSError: [Errno 22] Invalid argument", None),
    ):
        monkeypatch.setitem(DISPLAYS, "ST7735R", answering(answer))
        finding = findings(bed, wired)[name]
        assert finding.outcome == outcome
        assert found in finding.found
        assert remedy is None or finding.remedy == remedy
    # It is left alone where nothing says that it can answer.
    assert name not in findings(bed, plan)
    bed.missing.append("gpiod")
    finding = findings(bed, wired)[name]
    assert (finding.outcome, finding.found) == ("skipped", "needs spidev and gpiod")


def test_setting_that_is_misspelled_is_said(
    bed: Bed, plan: DoctorSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert findings(bed, plan)["environment"].outcome == "ok"
    monkeypatch.setenv("VEILCAM_PANELTAB", "red")
    found = findings(bed, plan)["environment"]
    assert (found.outcome, found.found) == ("bad", "VEILCAM_PANELTAB: no setting")
    assert found.remedy == "did you mean VEILCAM_PANEL_TAB?"


def test_bundle_that_its_owner_did_not_sign_is_said(
    bed: Bed, plan: DoctorSettings, tmp_path: Path
) -> None:
    keys, wanted = tmp_path / "owners", plan.model_copy(update={"owner_keys": tmp_path / "owners"})
    found = findings(bed, wanted)["owner"]
    assert (found.outcome, found.remedy) == ("bad", "check it")
    owner = write_key(tmp_path / "owner.pem")
    keys.write_text(f"{owner}\n")
    found = findings(bed, wanted)["owner"]
    assert (found.outcome, found.found) == ("bad", "this bundle is not signed")
    assert found.remedy == f"this camera takes bundles that {owner.short} signed"
    assert plan.bundle is not None
    sign_bundle(plan.bundle, 3, read_key(tmp_path / "owner.pem"))
    found = findings(bed, wanted)["owner"]
    assert (found.outcome, found.found) == ("ok", f"version 3, signed by {owner.short}")


def test_state_directory_that_is_not_there_yet(bed: Bed, plan: DoctorSettings) -> None:
    elsewhere = plan.model_copy(update={"state_dir": Path("/var/lib/other/deep")})
    assert "made at the first start" in findings(bed, elsewhere)["state directory"].found
    bed.locked.append("/var/lib")
    finding = findings(bed, elsewhere)["state directory"]
    assert finding.outcome == "bad"
    assert "install -d -m 700" in str(finding.remedy)


def test_damaged_bundle_is_said(
    bed: Bed, plan: DoctorSettings, fresh_file: Path, tmp_path: Path
) -> None:
    fresh = findings(bed, plan.model_copy(update={"bundle": fresh_file}))
    assert fresh["bundle"].found == f"{fresh_file}: mnist, fresh"
    damaged = tmp_path / "damaged.veilcam"
    damaged.write_bytes(fresh_file.read_bytes()[:-100])
    found = findings(bed, plan.model_copy(update={"bundle": damaged}))
    assert (found["bundle"].outcome, found["owner"].outcome) == ("bad", "skipped")
    none = findings(bed, plan.model_copy(update={"bundle": None}))
    assert {name for name, each in none.items() if each.outcome == "skipped"} == {"owner"}


@pytest.mark.skipif(Path("/proc/device-tree/model").exists(), reason="this is a board")
def test_command_here_says_what_to_do_and_fails(tmp_path: Path) -> None:
    """On a computer that is no Raspberry Pi, with the real checks."""
    state = ["--state-dir", str(tmp_path / "state")]
    result = runner.invoke(app, ["doctor", *state])
    assert result.exit_code == 1
    assert "no Raspberry Pi" in result.stdout
    assert "to fix" in result.stdout
    assert not (tmp_path / "state").exists()
    result = runner.invoke(app, ["doctor", "--json", "--data-line", "7", *state])
    assert result.exit_code == 1
    entries = {entry["name"]: entry for entry in json.loads(result.stdout)}
    assert entries["board"]["outcome"] == "bad"
    assert entries["panel tab"]["remedy"].startswith("give --panel-tab")
    result = runner.invoke(app, ["doctor", "--spi-hz", "1", *state])
    assert result.exit_code == 2
    assert "--spi-hz" in result.stderr


def test_command_ends_well_where_all_is_well(
    bed: Bed, plan: DoctorSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machines, "Machine", lambda: bed.machine)
    options = ["--state-dir", str(plan.state_dir), "--bundle", str(plan.bundle)]
    result = runner.invoke(app, ["doctor", "--panel-tab", "green", *options])
    assert result.exit_code == 0, result.stdout
    assert "all is well" in result.stdout
    monkeypatch.setenv("VEILCAM_PANEL_TAB", "red")
    monkeypatch.setenv("VEILCAM_BUNDLE", str(plan.bundle))
    result = runner.invoke(app, ["doctor", "--state-dir", str(plan.state_dir)])
    assert result.exit_code == 0, result.stdout


def test_beside_a_daemon_nothing_is_opened_and_no_path_is_told(
    tmp_path: Path, bundle_file: Path
) -> None:
    def touch(*_: object) -> Never:
        raise AssertionError("the daemon holds it")

    state = tmp_path / "state"
    state.mkdir(mode=0o755)
    machine = Machine(load=touch, chips=touch, line_user=touch, open_camera=touch)
    for device in ("simulated", "pi"):
        given = {"device": device, "bundle": bundle_file, "state_dir": state}
        settings = Settings.model_validate(given)
        found = {each.name: each for each in examine_beside(machine, settings)}
        # What is of the machine, and not of the daemon, matters to a real camera alone.
        assert ("board" in found) is (device == "pi")
        assert {"environment", "state directory", "disk", "bundle", "owner"} <= set(found)
        assert str(tmp_path) not in str(found)
        assert found["state directory"].remedy == "chmod 700 $VEILCAM_STATE_DIR"
        assert found["bundle"].found.startswith("$VEILCAM_BUNDLE: ")
