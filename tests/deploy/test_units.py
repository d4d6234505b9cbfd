"""What is installed on a device: systemd accepts the units, and the daemon the settings."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from deploy import config
from typer.main import get_command

from veilcam_client.discovery import TYPE
from veilcam_mqtt.cli import app as mqtt
from veilcam_server.settings import DEFAULT_PORT, Settings

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"

analyses = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None,
    reason="systemd-analyze is not here: apt install systemd",
)


def analyze(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = ["systemd-analyze", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def fields(name: str) -> dict[str, str]:
    return dict(re.findall(r"(?m)^(\w+)=(.*)$", (DEPLOY / name).read_text()))


@pytest.fixture
def units(tmp_path: Path) -> Path:
    for name in ("veilcamd.service", "veilcamd.socket", "veilcam-mqtt.service"):
        text = (DEPLOY / name).read_text()
        program = r"/usr/(bin/veilcam[a-z-]*|lib/veilcam/release)"
        (tmp_path / name).write_text(re.sub(program, sys.executable, text))
    return tmp_path


@analyses
def test_systemd_understands_every_line(units: Path) -> None:
    service, socket = units / "veilcamd.service", units / "veilcamd.socket"
    bridge = units / "veilcam-mqtt.service"
    done = analyze("verify", "--recursive-errors=no", service, socket, bridge)
    assert (done.returncode, done.stderr) == (0, "")
    service.write_text(service.read_text() + "[Service]\nProtectEverything=yes\n")
    assert "ProtectEverything" in analyze("verify", "--recursive-errors=no", service).stderr


@analyses
def test_the_sandbox_leaves_little_exposed(units: Path) -> None:
    service = units / "veilcamd.service"
    # In tenths: exposure 1.1 of 10, of which asking for the state of the clock is 0.5.
    assert analyze("security", "--offline=true", "--threshold=11", service).returncode == 0
    opened = re.sub(r"(?m)^(ProtectSystem|PrivateNetwork)=.*\n", "", service.read_text())
    service.write_text(opened)
    assert analyze("security", "--offline=true", "--threshold=11", service).returncode != 0


def test_sandbox_lets_the_daemon_ask_for_the_clock_s_state_and_keeps_keys_in_memory() -> None:
    lines = (DEPLOY / "veilcamd.service").read_text().splitlines()
    # What is allowed comes after what takes it away. ProtectClock= would refuse it all the same.
    allowed = lines.index("SystemCallFilter=adjtimex clock_adjtime clock_adjtime64")
    assert allowed > lines.index("SystemCallFilter=~@privileged @resources")
    assert not [line for line in lines if line.startswith("ProtectClock=")]
    assert {"CapabilityBoundingSet=", "AmbientCapabilities=", "DevicePolicy=closed"} <= set(lines)
    # Keys reach neither a core file nor swap.
    assert {"LimitCORE=0", "MemorySwapMax=0"} <= set(lines)
    # What opens nothing earlier is not handed to the daemon in the first place.
    assert not any("Credential" in line for line in lines)


@analyses
def test_the_bridge_to_a_house_has_a_network_and_little_else(units: Path) -> None:
    # In tenths: exposure 1.4 of 10, of which the network and its addresses are 1.0.
    bridge = units / "veilcam-mqtt.service"
    done = analyze("security", "--offline=true", "--threshold=14", bridge)
    assert done.returncode == 0, done.stdout
    unit = (DEPLOY / "veilcam-mqtt.service").read_text().splitlines()
    assert {"DynamicUser=yes", "SupplementaryGroups=veilcam"} <= set(unit)
    # No token, no password: what stands in a unit everybody may read.
    assert [line for line in unit if "Credential" in line] == [
        "LoadCredential=house:/etc/veilcam/house"
    ]


def test_the_settings_of_the_bridge_that_come_along_are_settings() -> None:
    text = (DEPLOY / "mqtt.env").read_text()
    given = set(re.findall(r"(?m)^#?(VEILCAM_\w+)=", text))
    assert len(given) > 3
    assert given <= {each.envvar for each in get_command(mqtt).params}


@pytest.mark.parametrize("name", ["veilcamd", "veilcam-mqtt"])
def test_a_service_that_fails_is_started_again_for_ever(name: str) -> None:
    given = fields(f"{name}.service")
    assert (given["Restart"], given["StartLimitIntervalSec"]) == ("always", "0")
    assert float(given["RestartSec"]) >= 5
    # Debian 12 has systemd 252, which knows neither.
    assert not {"RestartSteps", "RestartMaxDelaySec"} & set(given)
    # Nor does the socket give up, however often it starts a daemon that ends.
    socket = (DEPLOY / "veilcamd.socket").read_text()
    assert "\nTriggerLimitIntervalSec=0\n" in socket


def test_no_path_of_its_own_slips_through_the_rule_for_everything() -> None:
    # systemd leaves such a path out of what it does to /: that it is read-only, or runs nothing.
    unit = (DEPLOY / "veilcamd.service").read_text()
    paths = {name: value.split() for name, value in re.findall(r"(?m)^(\w+Paths)=(.*)$", unit)}
    assert paths["NoExecPaths"][0] == "/"
    assert paths["BindReadOnlyPaths"] == paths["ExecPaths"]
    assert {
        f"/var/lib/{fields('veilcamd.service')['StateDirectory']}",
        "/tmp",
        "/var/tmp",
        "/dev/shm",
    } <= set(paths["NoExecPaths"])


def test_every_setting_is_explained_in_the_file_that_comes_along() -> None:
    text = (DEPLOY / "veilcam.env").read_text()
    assert text == config.template(), "run python -m deploy.config"
    explained = re.findall(r"(?m)^# \S.*\n#?VEILCAM_(\w+)=", text)
    assert {name.lower() for name in explained} == set(Settings.model_fields)
    # But for the bundle, nothing is said that a later release could not say otherwise.
    assert re.findall(r"(?m)^[^#\n]+", text) == [f"VEILCAM_BUNDLE={config.BUNDLE}"]


def test_a_value_in_that_file_may_stay_or_be_taken_into_force(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = dict(re.findall(r"(?m)^#?(VEILCAM_\w+)=(.+)$", (DEPLOY / "veilcam.env").read_text()))
    untouched = Settings(bundle=Path(config.BUNDLE))
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    read = Settings()  # type: ignore[call-arg]
    assert {name.removeprefix("VEILCAM_").lower() for name in given} == read.model_fields_set
    differ = {
        name for name in Settings.model_fields if getattr(read, name) != getattr(untouched, name)
    }
    assert differ == {"panel_tab", "owner_keys", "rotation", "hosts"}
    assert len(given) > 25


def test_one_port_everywhere() -> None:
    assert f"ListenStream=127.0.0.1:{DEFAULT_PORT}\n" in (DEPLOY / "veilcamd.socket").read_text()
    avahi = ET.parse(DEPLOY / "veilcam.avahi")
    assert avahi.findtext("service/port") == str(DEFAULT_PORT)
    resolved = fields("veilcam.dnssd")
    assert resolved["Port"] == str(DEFAULT_PORT)
    # What `veilcam discover` looks for.
    assert f"{avahi.findtext('service/type')}.local." == f"{resolved['Type']}.local." == TYPE
    told = {each.text for each in avahi.findall("service/txt-record")}
    assert told == set(resolved["TxtText"].split()) == {"api=v1", "scheme=https"}


CONVOLVE = """
import ctypes, sys
PR_SET_MDWE, REFUSE_EXEC_GAIN = 65, 1
if ctypes.CDLL(None).prctl(PR_SET_MDWE, REFUSE_EXEC_GAIN, 0, 0, 0) != 0:
    sys.exit(77)
import numpy, torch
from veilcam_server.devices.simulated.light import use_torch_sparingly
from veilcam_training.bundle import Network
from veilcam_training.bundle.layers import Conv2d
use_torch_sparingly()
print(torch.nn.Conv2d(1, 8, 5)(torch.ones(1, 1, 24, 32)).shape)
weights = {"0.weight": numpy.ones((8, 1, 5, 5), "f4"), "0.bias": numpy.ones(8, "f4")}
layers = (Conv2d(inputs=1, outputs=8, kernel=5, padding=0),)
print(Network.load(layers, weights)(numpy.ones((1, 1, 24, 32), "f4")).shape)
"""


@pytest.mark.thorough
def test_classifiers_run_without_memory_that_is_both_written_and_executed() -> None:
    command = [sys.executable, "-c", CONVOLVE]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 77:
        pytest.skip("this kernel cannot forbid it to one process (Linux 6.3 can)")
    assert done.stdout == "torch.Size([1, 8, 20, 28])\n(1, 8, 20, 28)\n", done.stderr
    assert "MemoryDenyWriteExecute=yes\n" in (DEPLOY / "veilcamd.service").read_text()
