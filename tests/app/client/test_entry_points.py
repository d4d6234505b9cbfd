"""The commands as they are installed, where an extra is not."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path

import pytest

PROJECT = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
SCRIPTS: dict[str, str] = PROJECT["scripts"]
EXTRAS = ("torch", "scipy", "matplotlib", "PIL", "safetensors", "pooch", "fastapi", "aiomqtt")
"""First imports of every extra: without them there is the base install alone."""


def run(command: str, *arguments: str, without: Iterable[str]) -> subprocess.CompletedProcess[str]:
    """Run a command of the project as its script does, where some modules are not installed."""
    module, _, function = SCRIPTS[command].partition(":")
    program = (
        f"import sys; sys.modules.update(dict.fromkeys({list(without)!r}))\n"
        f"from {module} import {function}; {function}()"
    )
    return subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=False
    )


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("command", "arguments", "missing", "extra"),
    [
        ("veilcamd", ["serve", "--simulate"], EXTRAS, "server"),
        ("veilcamd", ["serve", "--simulate"], ["uvicorn"], "server"),
        ("veilcam-train", ["--help"], EXTRAS, "training"),
        ("veilcam-optics", ["--help"], EXTRAS, "optics"),
        ("veilcam-mqtt", ["--help"], EXTRAS, "mqtt"),
    ],
)
def test_a_command_names_the_extra_that_it_needs(
    command: str, arguments: list[str], missing: list[str], extra: str
) -> None:
    assert extra in PROJECT["optional-dependencies"]
    done = run(command, *arguments, without=missing)
    assert done.returncode == 1
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"{command} needs the extra '{extra}' (")
    assert any(f"({name} is not installed)" in line for name in missing)
    assert line.endswith(f": run pip install -e '.[{extra}]' in the checkout")


def test_the_client_needs_none() -> None:
    done = run("veilcam", "--help", without=EXTRAS)
    assert done.returncode == 0, done.stderr
    assert "classify" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("command", [each for each in SCRIPTS if each != "veilcam"])
def test_a_command_that_has_its_extra_runs(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module, _, function = SCRIPTS[command].partition(":")
    monkeypatch.setattr(sys, "argv", [command, "--help"])
    with pytest.raises(SystemExit) as ended:
        getattr(import_module(module), function)()
    assert ended.value.code == 0
    assert "Usage" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("missing", ["veilcam_server", "veilcam_server.settings", "getpass"])
def test_what_no_extra_brings_is_a_defect_that_is_not_hidden(missing: str) -> None:
    done = run("veilcamd", "--help", without=[missing])
    assert done.returncode == 1
    assert "Traceback" in done.stderr
    assert missing in done.stderr.splitlines()[-1]
    assert "needs the extra" not in done.stderr


MODULES = ("veilcam_server", "veilcam_mqtt")
"""Packages that ``python -m`` runs."""
TELL = """
import os, runpy, sys

class Tell:
    def find_spec(self, name, *_):
        if name in ("numpy", "torch", "typer"):
            print("threads", os.environ.get("OMP_NUM_THREADS"), flush=True)
            os._exit(0)

sys.meta_path.insert(0, Tell())
sys.argv = ["command", "--help"]
"""
"""Tells how many threads are set when the first library is loaded, and ends."""


@pytest.mark.parametrize("chosen", [None, "3"])
@pytest.mark.parametrize("started", [*SCRIPTS, *(f"-m {module}" for module in MODULES)])
def test_a_command_computes_on_one_thread_unless_the_user_chose(
    started: str, chosen: str | None
) -> None:
    module, _, function = SCRIPTS.get(started, "").partition(":")
    run_it = (
        f"runpy.run_module({started.removeprefix('-m ')!r}, run_name='__main__')"
        if started.startswith("-m ")
        else f"from {module} import {function}; {function}()"
    )
    environment = {name: text for name, text in os.environ.items() if name != "OMP_NUM_THREADS"}
    if chosen is not None:
        environment["OMP_NUM_THREADS"] = chosen
    done = subprocess.run(
        [sys.executable, "-c", TELL + run_it],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"threads {chosen or 1}\n"
