"""A daemon that can import neither torch nor SciPy: all of it, and what it reads behind masks."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

_MISSING = """
import sys
from benchmarks.deploy.device_path import NotInstalled

sys.meta_path.insert(0, NotInstalled())
"""


def run(*command: str) -> str:
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_all_of_a_daemon_is_imported() -> None:
    """With its calibration, and the command line but for commands that simulate or draw."""
    modules = ("daemon", "cli.main", "cli.calibration_session", "calibration.procedure", "doctor")
    imports = "\n".join(f"import veilcam_server.{module}" for module in modules)
    run("-c", f"{_MISSING}\nimport veilcam_client.decoding\n{imports}")


@pytest.mark.thorough
@pytest.mark.parametrize("mode", ["fresh", "pairs"])
def test_device_reads_frames_behind_masks_of_the_bundles_that_come_along(mode: str) -> None:
    taken = json.loads(run("-m", "benchmarks.deploy.device_path", mode))
    assert len(taken["labels"]) == 5
    assert set(taken["labels"]) <= set(range(10))
    # Torch alone takes 218 MiB: no room for it, whatever the machine.
    assert taken["peak_mib"] < 200


def test_simulated_light_without_torch_says_what_to_install() -> None:
    said = run(
        "-c",
        f"""{_MISSING}
from veilcam_server.demo_data import BUNDLE
from veilcam_server.devices.errors import DeviceMissingError
from veilcam_server.devices.registry import open_device
from veilcam_server.settings import Settings
from veilcam_training.bundle import read_bundle

try:
    open_device(Settings(bundle=BUNDLE, device="simulated"), read_bundle(BUNDLE))
except DeviceMissingError as error:
    print(error)
""",
    )
    assert said == (
        "simulated light needs torch: run pip install -e '.[simulate]' in the checkout\n"
    )
