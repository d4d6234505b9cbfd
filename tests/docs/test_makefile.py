"""The Makefile's environment: which Python makes it, and where its torch comes from."""

from __future__ import annotations

import http.server
import os
import shutil
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

# Runs programs with the Python of the tests, but only notes what it would install.
GOOD = f"""#!/bin/sh
case "$1 $2" in
"-m venv") mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;
"-m pip") shift 2; echo "${{0##*/}} $*" >> "$NOTES" ;;
*) exec "{sys.executable}" "$@" ;;
esac
"""
SHIM = "#!/bin/sh\necho 'command not found' >&2; exit 127\n"
OLD = f"""#!/bin/sh
exec "{sys.executable}" -c "import sys; sys.version_info = (3, 10, 13); $2"
"""
WITHOUT_PIP = GOOD.replace("case", 'case "$2" in *ensurepip*) exit 1;; esac\ncase', 1)


@dataclass
class Machine:
    root: Path

    def __post_init__(self) -> None:
        self.programs = self.root / "programs"
        self.programs.mkdir()
        for name in ("cp", "mkdir", "touch"):
            (self.programs / name).symlink_to(shutil.which(name) or pytest.fail(name))

    def add(self, name: str, script: str) -> Path:
        path = self.programs / name
        path.write_text(script)
        path.chmod(0o755)
        return path

    def install(self, *variables: str) -> subprocess.CompletedProcess[str]:
        environment = self.root / "environment"
        return subprocess.run(
            [
                shutil.which("make") or pytest.fail("make"),
                f"--directory={ROOT}",
                f"VENV={environment}",
                *variables,
                f"{environment}/.installed",
            ],
            env={"PATH": str(self.programs), "NOTES": str(self.root / "notes")},
            capture_output=True,
            text=True,
            check=False,
        )

    def installed(self) -> str:
        return (self.root / "notes").read_text()


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


@pytest.fixture
def index(tmp_path: Path) -> Iterator[str]:
    (tmp_path / "index" / "torch").mkdir(parents=True)
    handler = partial(Quiet, directory=str(tmp_path / "index"))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *arguments: object) -> None:
        """Drop it."""


def test_the_first_python_that_runs_and_is_recent_is_taken(machine: Machine) -> None:
    machine.add("python3.13", SHIM)
    machine.add("python3.12", OLD)
    machine.add("python3.11", GOOD + "# taken\n")
    machine.add("python3", GOOD)
    ended = machine.install("TORCH_INDEX=")
    assert ended.returncode == 0, ended.stderr
    assert "# taken" in (machine.root / "environment" / "bin" / "python").read_text()
    assert machine.installed().endswith("install --editable .[all,dev]\n")
    named = machine.add("mine", GOOD + "# named\n")
    shutil.rmtree(machine.root / "environment")
    assert machine.install("TORCH_INDEX=", f"PYTHON={named}").returncode == 0
    assert "# named" in (machine.root / "environment" / "bin" / "python").read_text()


@pytest.mark.parametrize(
    ("scripts", "variables", "said"),
    [
        ({}, [], "each of python3.13 python3.12 python3.11 python3 is missing, fails or is older"),
        ({"python3": OLD}, [], "each of python3.13 python3.12 python3.11 python3 is missing"),
        ({"python3": GOOD, "old": OLD}, ["PYTHON=old"], "old is missing, fails or is older than"),
        ({"python3": GOOD, "shim": SHIM}, ["PYTHON=shim"], "shim is missing, fails or is older"),
        ({"python3": GOOD}, ["PYTHON=none"], "none is missing, fails or is older than Python 3.11"),
        ({"python3": WITHOUT_PIP}, [], "python3 has no module venv, or no pip for it"),
    ],
    ids=["none", "too old", "named and old", "named and fails", "named and missing", "no venv"],
)
def test_what_is_wrong_is_said_in_a_line(
    machine: Machine, scripts: dict[str, str], variables: list[str], said: str
) -> None:
    for name, script in scripts.items():
        machine.add(name, script)
    ended = machine.install("TORCH_INDEX=", *variables)
    assert ended.returncode != 0
    line, *rest = ended.stderr.splitlines()
    assert said in line
    assert "PYTHON=PATH" in line
    assert all("***" in other for other in rest), ended.stderr  # make's own
    assert not (machine.root / "notes").exists()


def test_torch_comes_from_its_index_where_that_answers(machine: Machine, index: str) -> None:
    machine.add("python3.11", GOOD)
    assert machine.install(f"TORCH_INDEX={index}").returncode == 0
    assert f"--extra-index-url {index} " in machine.installed()


def test_an_index_without_an_answer_is_left_out_and_named(machine: Machine) -> None:
    machine.add("python3.11", GOOD)
    with socket.socket() as unused:  # bound, and nothing listens: connections are refused
        unused.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{unused.getsockname()[1]}"
        ended = machine.install(f"TORCH_INDEX={url}")
    assert ended.returncode == 0, ended.stderr
    assert f"no answer from {url}" in ended.stdout
    assert "index" not in machine.installed()


def test_byte_code_is_kept_whatever_a_container_asks_for(tmp_path: Path) -> None:
    program = tmp_path / "bin" / "pytest"
    program.parent.mkdir()
    program.write_text('#!/bin/sh\necho "byte code ${PYTHONDONTWRITEBYTECODE:-is kept}"\n')
    program.chmod(0o755)
    (tmp_path / ".installed").touch()
    made = subprocess.run(
        ["make", f"--directory={ROOT}", f"VENV={tmp_path}", "fast"],
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "byte code is kept\n" in made.stdout
