"""The script that boots the virtual machines, as far as it goes without one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from deploy.debian.build import Architecture
from tests.system.virtual_machine.run import MACHINES

ROOT = Path(__file__).resolve().parents[2]


def test_the_script_finds_the_repository_from_anywhere(tmp_path: Path) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    # What make's environment has installed; the packages of the repository's root are not among it.
    packages = [str(ROOT / name) for name in ("client", "optics", "training", "server")]
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests/system/virtual_machine/run.py"), "--help"],
        check=False,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**environment, "PYTHONPATH": os.pathsep.join(packages)},
    )
    assert done.returncode == 0, done.stderr


def test_every_architecture_of_the_package_has_a_machine_and_a_figure_of_its_own() -> None:
    assert set(MACHINES) == set(Architecture)
    assert len({machine.figure for machine in MACHINES.values()}) == len(MACHINES)
    for machine in MACHINES.values():
        assert any("{results}" in argument for argument in machine.arguments)
