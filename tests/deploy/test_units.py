"""What is installed on a device: systemd accepts the units, and the daemon the settings."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from veilcam_server.settings import DEFAULT_PORT, Settings

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"

analyses = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None,
    reason="systemd-analyze is not here: apt install systemd",
)


def analyze(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = ["systemd-analyze", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture
def units(tmp_path: Path) -> Path:
    """The units in a folder, with a program that exists."""
    for name in ("veilcamd.service", "veilcamd.socket"):
        text = (DEPLOY / name).read_text()
        (tmp_path / name).write_text(
            text.replace("/opt/veilcam/current/bin/veilcamd", sys.executable)
        )
    return tmp_path


@analyses
def test_systemd_understands_every_line(units: Path) -> None:
    service, socket = units / "veilcamd.service", units / "veilcamd.socket"
    done = analyze("verify", "--recursive-errors=no", service, socket)
    assert (done.returncode, done.stderr) == (0, "")
    service.write_text(service.read_text() + "[Service]\nProtectEverything=yes\n")
    assert "ProtectEverything" in analyze("verify", "--recursive-errors=no", service).stderr


@analyses
def test_the_sandbox_leaves_little_exposed(units: Path) -> None:
    service = units / "veilcamd.service"
    # In tenths: exposure 1.0 of 10.
    assert analyze("security", "--offline=true", "--threshold=10", service).returncode == 0
    opened = re.sub(r"(?m)^(ProtectSystem|PrivateNetwork)=.*\n", "", service.read_text())
    service.write_text(opened)
    assert analyze("security", "--offline=true", "--threshold=10", service).returncode != 0


def test_a_daemon_that_fails_is_started_again_for_ever() -> None:
    unit = (DEPLOY / "veilcamd.service").read_text()
    given = dict(re.findall(r"(?m)^(\w+)=(.*)$", unit))
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
    state = re.search(r"(?m)^StateDirectory=(.*)$", unit)
    assert state is not None
    assert {f"/var/lib/{state[1]}", "/tmp", "/var/tmp", "/dev/shm"} <= set(paths["NoExecPaths"])


def test_the_settings_that_come_along_are_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    # Those that are commented out too.
    given = dict(re.findall(r"(?m)^#?(VEILCAM_\w+)=(.*)$", (DEPLOY / "veilcam.env").read_text()))
    names = {name.removeprefix("VEILCAM_").lower() for name in given}
    assert {"bundle", "device", "rotation"} <= names <= set(Settings.model_fields)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    assert names <= Settings().model_fields_set  # type: ignore[call-arg]


def test_keys_reach_neither_a_core_file_nor_swap() -> None:
    unit = (DEPLOY / "veilcamd.service").read_text().splitlines()
    assert {"LimitCORE=0", "MemorySwapMax=0"} <= set(unit)
    # What opens nothing earlier is not handed to the daemon in the first place.
    assert not any("Credential" in line for line in unit)


def test_one_port_everywhere() -> None:
    assert f"ListenStream=127.0.0.1:{DEFAULT_PORT}\n" in (DEPLOY / "veilcamd.socket").read_text()
    announced = ET.parse(DEPLOY / "veilcam.avahi").findtext("service/port")
    assert announced == str(DEFAULT_PORT)


CONVOLVE = """
import ctypes, sys
PR_SET_MDWE, REFUSE_EXEC_GAIN = 65, 1
if ctypes.CDLL(None).prctl(PR_SET_MDWE, REFUSE_EXEC_GAIN, 0, 0, 0) != 0:
    sys.exit(77)
import torch
from veilcam_server.daemon import configure_torch
configure_torch()
print(torch.nn.Conv2d(1, 8, 5)(torch.ones(1, 1, 24, 32)).shape)
"""


@pytest.mark.slow
def test_classifiers_run_without_memory_that_is_both_written_and_executed() -> None:
    command = [sys.executable, "-c", CONVOLVE]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 77:
        pytest.skip("this kernel cannot forbid it to one process (Linux 6.3 can)")
    assert "torch.Size([1, 8, 20, 28])" in done.stdout, done.stderr
    assert "MemoryDenyWriteExecute=yes\n" in (DEPLOY / "veilcamd.service").read_text()
